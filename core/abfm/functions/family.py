"""What every family of functions has: a name, typed parameters, a text form and an evaluation."""

import inspect
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from typing import Any, ClassVar, NamedTuple

from abfm.errors import FunctionError, brief, did_you_mean
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


class Spec(ABC):
    """A function without a mesh; ``str(spec)`` is its text form, which parses to an equal one."""

    @abstractmethod
    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        """Return values at the vertices, (V,)."""


@dataclass(frozen=True)
class ValueKind:
    """What a parameter accepts."""

    name: str  # in messages
    # how text becomes a value; ValueError where it cannot
    read: Callable[[str], Any] = field(repr=False)
    choices: tuple[str, ...] = ()  # all values, where they are few names
    whole: bool = False  # whether its numbers are whole
    suffixes: tuple[str, ...] = ()  # endings of the files that it names


class Slider(NamedTuple):
    """The ends of a parameter's slider; values beyond them can be typed."""

    low: float
    high: float
    log: bool = False


class Shape(NamedTuple):
    """A way to describe a function of a family: in words, by an example, with some parameters."""

    summary: str
    example: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class Parameter:
    """One key of a family: all that the text form, help texts, messages and forms know about it."""

    name: str
    kind: ValueKind
    summary: str  # what it means, as the beginning of a sentence in small letters
    default: Any  # MISSING where it must be given; an optional one without a default has None
    unit: str = ""
    # what a form draws for a number, or what finds it for a function of the family and a mesh
    slider: Slider | Callable[[Any, TriangleMesh], Slider | None] | None = None
    empty: str = "automatic"  # the words for None in a form; "" where a form does not offer it
    instead_of: str = ""  # another parameter which, when it is given, takes the place of this one

    @property
    def required(self) -> bool:
        """Whether it must be given."""
        return self.default is MISSING


def parameter(kind: ValueKind, summary: str, *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field of a family, with the attributes of :class:`Parameter`."""
    return field(
        default=default, metadata={"kind": kind, "summary": summary, "default": default, **more}
    )


@dataclass(frozen=True, kw_only=True)
class Family(Spec):
    """A family of functions: subclasses are frozen dataclasses with fields by :func:`parameter`.

    Values may be text: they are read and checked on construction, which raises FunctionError.
    """

    family: ClassVar[str]
    positional: ClassVar[str | None] = None  # the parameter that may stand without its key
    is_open_ended: ClassVar[bool] = False  # whether it then extends to the end of the text
    # what a form begins with, unless it is the name alone; {vertex} and {middle}, the mean of y,
    # are the mesh's
    example: ClassVar[str] = ""
    shapes: ClassVar[Mapping[str, Shape]] = {}  # by name, where there are several

    def __post_init__(self) -> None:
        for p in self.parameters():
            value = getattr(self, p.name)
            if value is not None:
                object.__setattr__(self, p.name, _read(self.family, p, value))
        self.check()

    def check(self) -> None:
        """Raise FunctionError where parameters that are right one by one do not fit together."""

    @classmethod
    @cache
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return all parameters, in the order of the text form."""
        return tuple(Parameter(f.name, **f.metadata) for f in fields(cls) if "kind" in f.metadata)

    def _given(self) -> dict[str, Any]:
        found = {p.name: getattr(self, p.name) for p in self.parameters()}
        return {p.name: found[p.name] for p in self.parameters() if found[p.name] != p.default}

    def shape(self) -> str:
        """Return which of the shapes it has: the first that has all parameters given."""
        given = self._given().keys()
        fitting = (name for name, shape in self.shapes.items() if given <= set(shape.parameters))
        return next(fitting, "")

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the docstring."""
        return (inspect.getdoc(cls) or "").partition("\n")[0]

    def __str__(self) -> str:
        given = sorted(self._given().items(), key=lambda item: item[0] != self.positional)
        words = [("" if n == self.positional else f"{n}=") + _text(value) for n, value in given]
        return f"{self.family}:{','.join(words)}" if words else self.family


def _read(family: str, p: Parameter, value: Any) -> Any:
    text = ",".join(map(str, value)) if isinstance(value, tuple | list) else str(value).strip()
    try:
        return p.kind.read(text)
    except (ValueError, OverflowError):
        unit = f" (unit: {p.unit})" if p.unit else ""
        hint = did_you_mean(text, p.kind.choices)
        raise FunctionError(
            f"{family}: {p.name} must be {p.kind.name}{unit}, not {brief(text)}{hint}"
        ) from None


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return quoted(value) if isinstance(value, str) else repr(value)


def quoted(text: str) -> str:
    """Return text as a spec can hold it: in double quotes where the parser would read a sign."""
    plain = re.fullmatch(r"[\w./\\~:-]+( [\w./\\~:-]+)*", text)
    return text if plain else '"' + text.replace('"', '""') + '"'


def _checked(read: Callable[[str], Any], accepts: Callable[[Any], bool]) -> Callable[[str], Any]:
    def checked(text: str) -> Any:
        value = read(text)
        if not accepts(value):
            raise ValueError
        return value

    return checked


_index = _checked(int, lambda value: 0 <= value < 2**31)
_count = _checked(int, lambda value: 0 < value <= 2**31)
_nonempty = _checked(str, lambda text: bool(text) and "\0" not in text)

NUMBER = ValueKind("a finite number", _checked(float, math.isfinite))
POSITIVE_REAL = ValueKind("a number above 0", _checked(float, lambda value: 0 < value < math.inf))
INDEX = ValueKind("a whole number, 0 or more", _index, whole=True)
COUNT = ValueKind("a whole number, 1 or more", _count, whole=True)
VERTICES = ValueKind(
    "one vertex number or several with commas, counted from 0",
    lambda text: tuple(_index(part) for part in text.split(",")),
)
WORD = ValueKind("a name or a number", _nonempty)


def file_name(*suffixes: str) -> ValueKind:
    """Return the kind of names of files with one of some endings."""
    return ValueKind("the name of a file", _nonempty, suffixes=suffixes)


def choice(*names: str) -> ValueKind:
    """Return the kind that is one of a few names."""
    listed = " or ".join([", ".join(names[:-1]), names[-1]])
    return ValueKind(listed, _checked(str, names.__contains__), names)


def texts_of(given: Any) -> list[str] | None:
    """Return functions given as a text or a list of texts; None for anything else."""
    if isinstance(given, str):
        return [given]
    is_list = isinstance(given, list | tuple) and len(given) > 0
    return [*given] if is_list and all(isinstance(text, str) for text in given) else None

"""Base class of function families: name, typed parameters, text form and evaluation."""

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
    """Specification of a function without a mesh; parsing ``str(spec)`` gives an equal one."""

    @abstractmethod
    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        """Return the values (V,) of the function at the vertices of a mesh."""


@dataclass(frozen=True)
class ValueKind:
    """Type of the values of a parameter."""

    name: str  # name of the type in messages
    read: Callable[[str], Any] = field(repr=False)  # converts text; ValueError for invalid text
    choices: tuple[str, ...] = ()  # all values, if there are only a few
    integers: bool = False  # whether the values are integers
    suffixes: tuple[str, ...] = ()  # allowed endings of file names


class Slider(NamedTuple):
    """Range of the slider of a parameter in a form; users can type values beyond it."""

    low: float
    high: float
    log: bool = False


class Shape(NamedTuple):
    """One of several forms of a family, such as disc or half-space of an indicator."""

    summary: str
    example: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class Parameter:
    """A parameter of a family, as used by the text form, help texts, messages and forms."""

    name: str
    kind: ValueKind
    summary: str  # a short description that begins in lower case
    default: Any  # MISSING if required; None if optional without a default
    unit: str = ""
    # the slider of a number in a form, or a function that returns it for a function and a mesh
    slider: Slider | Callable[[Any, TriangleMesh], Slider | None] | None = None
    empty: str = "automatic"  # label of None in a form; "" if a form does not offer it
    instead_of: str = ""  # another parameter, which replaces this one if it is set

    @property
    def required(self) -> bool:
        """Whether the parameter has no default."""
        return self.default is MISSING


def parameter(kind: ValueKind, summary: str, *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a field of a family as a parameter, with ``more`` attributes of `Parameter`."""
    return field(
        default=default, metadata={"kind": kind, "summary": summary, "default": default, **more}
    )


@dataclass(frozen=True, kw_only=True)
class Family(Spec):
    """Base class of function families.

    Subclasses are frozen dataclasses whose fields are declared by ``parameter``. Values may be
    text. They are converted and checked on construction, which raises a FunctionError.
    """

    family: ClassVar[str]
    positional: ClassVar[str | None] = None  # the parameter whose key may be omitted
    is_open_ended: ClassVar[bool] = False  # whether its value extends to the end of the text
    # Initial text of a form; empty for the name of the family. Values of the mesh replace {vertex}
    # and {middle}, which is the mean of y.
    example: ClassVar[str] = ""
    shapes: ClassVar[Mapping[str, Shape]] = {}  # forms of the family by name, if there are several

    def __post_init__(self) -> None:
        for p in self.parameters():
            value = getattr(self, p.name)
            if value is not None:
                object.__setattr__(self, p.name, _read(self.family, p, value))
        self.check()

    def check(self) -> None:
        """Raise a FunctionError if the parameters do not fit together."""

    @classmethod
    @cache
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return all parameters, in the order of the text form."""
        return tuple(Parameter(f.name, **f.metadata) for f in fields(cls) if "kind" in f.metadata)

    def _changed(self) -> dict[str, Any]:
        found = {p.name: getattr(self, p.name) for p in self.parameters()}
        return {p.name: found[p.name] for p in self.parameters() if found[p.name] != p.default}

    def shape(self) -> str:
        """Return the name of the first form with all parameters that are set; empty if none."""
        changed = self._changed().keys()
        fitting = (name for name, shape in self.shapes.items() if changed <= set(shape.parameters))
        return next(fitting, "")

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the docstring of the family."""
        return (inspect.getdoc(cls) or "").partition("\n")[0]

    def __str__(self) -> str:
        changed = sorted(self._changed().items(), key=lambda item: item[0] != self.positional)
        words = [("" if n == self.positional else f"{n}=") + _text(value) for n, value in changed]
        return f"{self.family}:{','.join(words)}" if words else self.family


@dataclass(frozen=True, kw_only=True)
class Wrapper(Family):
    """Base class of families that change another function.

    In the text form, that function is in parentheses after the parameters.
    """

    function: Spec

    def __str__(self) -> str:
        text = super().__str__()
        return f"{text}{'' if ':' in text else ':'}({self.function})"


def _read(family: str, p: Parameter, value: Any) -> Any:
    text = ",".join(map(str, value)) if isinstance(value, tuple | list) else str(value).strip()
    try:
        return p.kind.read(text)
    except (ValueError, OverflowError):
        unit = f" (unit: {p.unit})" if p.unit else ""
        hint = did_you_mean(text, p.kind.choices)
        raise FunctionError(
            f"{family}: {p.name} is {brief(text)}{hint}; expected {p.kind.name}{unit}"
        ) from None


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return quoted(value) if isinstance(value, str) else repr(value)


def quoted(text: str) -> str:
    """Return a text, in double quotes if it has characters that the parser would interpret."""
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
INDEX = ValueKind("an integer, 0 or more", _index, integers=True)
COUNT = ValueKind("an integer, 1 or more", _count, integers=True)
VERTICES = ValueKind(
    "one vertex number or several separated by commas, counted from 0",
    lambda text: tuple(_index(part) for part in text.split(",")),
)
WORD = ValueKind("a name or a number", _nonempty)


def file_name(*suffixes: str) -> ValueKind:
    """Return the type of a parameter that is the name of a file with one of these endings."""
    return ValueKind("the name of a file", _nonempty, suffixes=suffixes)


def choice(*names: str) -> ValueKind:
    listed = " or ".join([", ".join(names[:-1]), names[-1]])
    return ValueKind(listed, _checked(str, names.__contains__), names)


def texts_of(functions: Any) -> list[str] | None:
    """Return functions given by a text, or by several texts, as a list; None for anything else."""
    if isinstance(functions, str):
        return [functions]
    is_list = isinstance(functions, list | tuple) and len(functions) > 0
    return [*functions] if is_list and all(isinstance(text, str) for text in functions) else None

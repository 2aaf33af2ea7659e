"""What every family of functions shares: a name, typed parameters, a text form and an evaluation."""

from __future__ import annotations

import inspect
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from typing import Any, ClassVar

from abfm.errors import FunctionError, did_you_mean
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


class Spec(ABC):
    """A function described without a mesh; ``str(spec)`` is its text form, which parses to an equal spec."""

    @abstractmethod
    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        """Values at the vertices, (V,)."""


@dataclass(frozen=True)
class Kind:
    """What a parameter accepts: its name in messages, and how text becomes a value (ValueError where it cannot)."""

    name: str
    read: Callable[[str], Any] = field(repr=False)
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Parameter:
    """One key of a family, as help texts and forms show it; an optional one without a default has default None."""

    name: str
    kind: Kind
    summary: str
    unit: str
    default: Any
    required: bool


def parameter(kind: Kind, summary: str, *, unit: str = "", default: Any = MISSING) -> Any:
    """Declare a dataclass field of a family; without ``default`` it must be given."""
    return field(default=default, metadata={"kind": kind, "summary": summary, "unit": unit})


@dataclass(frozen=True, kw_only=True)
class Family(Spec):
    """A family of functions: subclasses are frozen dataclasses whose fields are made by :func:`parameter`.

    Values may be given as text: they are read and checked on construction, which raises FunctionError.
    """

    family: ClassVar[str]
    positional: ClassVar[str | None] = None  # the parameter that may stand without its key

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
        """All parameters, in the order of the text form."""
        return tuple(_describe(f) for f in fields(cls) if "kind" in f.metadata)

    @classmethod
    def summary(cls) -> str:
        """First line of the docstring."""
        return (inspect.getdoc(cls) or "").partition("\n")[0]

    def __str__(self) -> str:
        given = [(p.name, getattr(self, p.name)) for p in self.parameters() if getattr(self, p.name) != p.default]
        given.sort(key=lambda item: item[0] != self.positional)
        words = [_text(value) if name == self.positional else f"{name}={_text(value)}" for name, value in given]
        return f"{self.family}:{','.join(words)}" if words else self.family


def _describe(f: Field[Any]) -> Parameter:
    required = f.default is MISSING
    default = None if required else f.default
    return Parameter(f.name, f.metadata["kind"], f.metadata["summary"], f.metadata["unit"], default, required)


def _read(family: str, p: Parameter, value: Any) -> Any:
    text = ",".join(map(str, value)) if isinstance(value, tuple | list) else str(value).strip()
    try:
        return p.kind.read(text)
    except (ValueError, OverflowError):
        unit = f" (unit: {p.unit})" if p.unit else ""
        hint = did_you_mean(text, p.kind.choices)
        raise FunctionError(f"{family}: {p.name} must be {p.kind.name}{unit}, not {shown(text)}{hint}") from None


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return quoted(value) if isinstance(value, str) else repr(value)


def quoted(text: str) -> str:
    """Text as a spec can hold it: in double quotes where a sign in it would mean something to the parser."""
    plain = re.fullmatch(r"[\w./\\~:-]+( [\w./\\~:-]+)*", text)
    return text if plain else '"' + text.replace('"', '""') + '"'


def shown(text: str) -> str:
    """Text as an error message shows it: on one line, in quotes, not too long."""
    return repr(text if len(text) <= 60 else f"{text[:45]}...{text[-10:]}")


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0:
        raise ValueError
    return value


def _index(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**31:
        raise ValueError
    return value


def _count(text: str) -> int:
    return _index(str(int(text) - 1)) + 1


def _nonempty(text: str) -> str:
    if not text or "\0" in text:
        raise ValueError
    return text


NUMBER = Kind("a finite number", _number)
POSITIVE = Kind("a number above 0", _positive)
INDEX = Kind("a whole number, 0 or more", _index)
INDICES = Kind(
    "one vertex number or several with commas, counted from 0",
    lambda text: tuple(_index(part) for part in text.split(",")),
)
COUNT = Kind("a whole number, 1 or more", _count)
PATH = Kind("the name of a file", _nonempty)
WORD = Kind("a name or a number", _nonempty)


def choice(*names: str) -> Kind:
    """One of a few names."""

    def read(text: str) -> str:
        if text not in names:
            raise ValueError
        return text

    return Kind(" or ".join([", ".join(names[:-1]), names[-1]]), read, names)

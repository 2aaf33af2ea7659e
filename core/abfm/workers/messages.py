"""What a worker and its process say to each other.

Values that never change, such as meshes, are sent by name: one goes to a process once, and no
result brings it back. The name is a digest of the content, the same in every process.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Container, Mapping
from typing import Any, Literal, NamedTuple, Protocol, TypeVar


class Named(Protocol):
    """A value that never changes."""

    @property
    def digest(self) -> str:
        """Name of the value by its content, in hexadecimal digits."""
        ...


Type = TypeVar("Type", bound=type[Named])
_named_types: set[type] = set()


def sent_by_name(named: Type) -> Type:
    """Decorate a class whose objects are to be sent by name."""
    _named_types.add(named)
    return named


class Parcel(NamedTuple):
    """A value as bytes, in which others stand by these names; with those of them, as pickles, that
    the other end does not have.
    """

    content: bytes
    names: tuple[str, ...]
    values: dict[str, bytes]

    def unpack(self, known: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Return the value, and what stands in it by name: ``known`` here or sent along."""
        came = {name: pickle.loads(content) for name, content in self.values.items()}
        named = {name: came[name] if name in came else known[name] for name in self.names}
        return _Unpickler(io.BytesIO(self.content), named).load(), named


def pack(value: object, known: Container[str] = ()) -> tuple[Parcel, dict[str, Any]]:
    """Return a value for an end that knows some names, and what stands in it by name."""
    file, named = io.BytesIO(), dict[str, Any]()
    _Pickler(file, named).dump(value)
    values = {
        name: pickle.dumps(each, protocol=5) for name, each in named.items() if name not in known
    }
    return Parcel(file.getvalue(), tuple(named), values), named


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, named: dict[str, Any]) -> None:
        super().__init__(file, protocol=5)
        self._named = named

    def persistent_id(self, value: Any) -> str | None:
        if type(value) not in _named_types:
            return None
        digest: str = value.digest
        self._named[digest] = value
        return digest


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, named: Mapping[str, Any]) -> None:
        super().__init__(file)
        self._named = named

    def persistent_load(self, digest: str) -> Any:
        return self._named[digest]


class Request(NamedTuple):
    """A call: a function and its arguments, to be answered at once if it is ``aside``."""

    number: int
    parcel: Parcel
    aside: bool


class Order(NamedTuple):
    """What a `Control` says to a call that may be under way."""

    number: int
    paused: bool
    cancelled: bool
    brief: bool


Kind = Literal["step", "report", "value", "error"]
"""What an answer is: on the way a step (or None) or another report, at the end one of the rest."""


class Answer(NamedTuple):
    """One of the answers to a request."""

    number: int
    kind: Kind
    parcel: Parcel

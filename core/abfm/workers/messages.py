"""What a worker and its process say to each other. Values that never change, such as meshes, are
sent by name, a digest of the content: one goes to a process once, and no result brings it back.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Container, Mapping
from typing import Any, Literal, NamedTuple, TypeVar

Type = TypeVar("Type", bound=type)
_named_types: set[type] = set()


def sent_by_name(named: Type) -> Type:
    """Decorate a class whose objects, which never change, are to be sent by their ``digest``."""
    _named_types.add(named)
    return named


class Parcel(NamedTuple):
    """A value, in which others stand by names, and pickles of those that the other end lacks."""

    content: bytes
    names: tuple[str, ...]
    values: dict[str, bytes]

    def unpack(self, known: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Return the value, and what stands in it by name: ``known`` here or sent along."""
        received = {name: pickle.loads(content) for name, content in self.values.items()}
        named = {name: received[name] if name in received else known[name] for name in self.names}
        unpickler = _Unpickler(io.BytesIO(self.content))
        unpickler.named = named
        return unpickler.load(), named


class _Pickler(pickle.Pickler):
    named: dict[str, Any]

    def persistent_id(self, value: Any) -> str | None:
        if type(value) not in _named_types:
            return None
        digest: str = value.digest
        self.named[digest] = value
        return digest


class _Unpickler(pickle.Unpickler):
    named: Mapping[str, Any]

    def persistent_load(self, digest: str) -> Any:
        return self.named[digest]


def pack(value: object, known: Container[str] = ()) -> tuple[Parcel, dict[str, Any]]:
    """Return a value for an end that knows some names, and what stands in it by name."""
    file, named = io.BytesIO(), dict[str, Any]()
    pickler = _Pickler(file, protocol=5)
    pickler.named = named
    pickler.dump(value)
    values = {
        name: pickle.dumps(each, protocol=5) for name, each in named.items() if name not in known
    }
    return Parcel(file.getvalue(), tuple(named), values), named


class Request(NamedTuple):
    """A call: a function and its arguments, to be answered at once if it is ``is_immediate``."""

    number: int
    parcel: Parcel
    is_immediate: bool


class ControlUpdate(NamedTuple):
    """What a `Control` says to a call that may be under way."""

    number: int
    paused: bool
    cancelled: bool
    skip_checks: bool


MessageKind = Literal["step", "report", "warning", "value", "error"]
"""What an answer is: on the way a step (or None), another report or the text of an `AbfmWarning`,
at the end one of the rest.
"""


class Answer(NamedTuple):
    """One of the answers to a request."""

    number: int
    kind: MessageKind
    parcel: Parcel

"""Messages between a worker and its subprocess.

Immutable values such as meshes are sent by name, which depends on their content. Each value is sent
to a process once, and the process never sends it back.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Container, Mapping
from typing import Any, Literal, NamedTuple, TypeVar

Type = TypeVar("Type", bound=type)
_named_types: set[type] = set()


def sent_by_name(named: Type) -> Type:
    """Register an immutable class, as a decorator, so that its ``message_name`` is sent."""
    _named_types.add(named)
    return named


class Parcel(NamedTuple):
    """A pickled value, and separate pickles of those named values in it that the receiver lacks."""

    content: bytes
    names: tuple[str, ...]
    values: dict[str, bytes]

    def unpack(self, known: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Return the value, and the named values in it by name.

        ``known`` are the named values that the receiver already has.
        """
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
        name: str = value.message_name
        self.named[name] = value
        return name


class _Unpickler(pickle.Unpickler):
    named: Mapping[str, Any]

    def persistent_load(self, name: str) -> Any:
        return self.named[name]


def pack(value: object, known: Container[str] = ()) -> tuple[Parcel, dict[str, Any]]:
    """Return a parcel with a value, and the named values in it by name.

    The parcel omits those that the receiver already has; ``known`` are their names.
    """
    file, named = io.BytesIO(), dict[str, Any]()
    pickler = _Pickler(file, protocol=5)
    pickler.named = named
    pickler.dump(value)
    values = {
        name: pickle.dumps(each, protocol=5) for name, each in named.items() if name not in known
    }
    return Parcel(file.getvalue(), tuple(named), values), named


class Request(NamedTuple):
    """A call of a function; an immediate call does not wait for earlier calls."""

    number: int
    parcel: Parcel
    is_immediate: bool


class ControlUpdate(NamedTuple):
    """Message with the state of the `Control` of a call, which may already have ended."""

    number: int
    paused: bool
    cancelled: bool
    skip_checks: bool


MessageKind = Literal["step", "report", "warning", "value", "error"]
"""Content of an answer.

During the call it is a step (or None), another report or the text of an `AbfmWarning`. At the end
it is the value or the error.
"""


class Answer(NamedTuple):
    """A step, a report, a warning, the value or the error of a requested call."""

    number: int
    kind: MessageKind
    parcel: Parcel

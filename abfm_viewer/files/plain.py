"""Dataclasses as plain JSON values and back, checked by their type hints."""

import math
import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from abfm.errors import brief


class PlainError(ValueError):
    """A value that does not fit its type hint; the text says where."""


def to_plain(value: Any, without: tuple[str, ...] = ()) -> Any:
    """Make dictionaries of dataclasses, the outermost without some fields, and lists of tuples."""
    if is_dataclass(value):
        names = [entry.name for entry in fields(value) if entry.name not in without]
        return {name: to_plain(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [to_plain(part) for part in value]
    return str(value) if isinstance(value, str) else value  # also words of an enumeration


def from_plain(hint: Any, value: Any, where: str, **given: Any) -> Any:
    """Return what `to_plain` was given, for a type hint; missing fields take their defaults.

    Fields that are given are not looked for in the value. A dataclass that has a `from_dict` of its
    own is made by that, which knows what older versions left out. A value of another type, not
    finite or not one of the choices, and a field that is unknown or missing, are a `PlainError`.
    """
    origin, options = get_origin(hint), get_args(hint)
    if origin is Literal:
        _check(value in options, where, value, " or ".join(map(repr, options)))
        return value
    if origin in (Union, types.UnionType):
        [inner] = [option for option in options if option is not type(None)]
        return None if value is None else from_plain(inner, value, where)
    if origin is tuple:
        _check(isinstance(value, list), where, value, "a list")
        kinds = [options[0]] * len(value) if options[1:] == (Ellipsis,) else list(options)
        _check(len(kinds) == len(value), where, value, f"{len(kinds)} entries")
        return tuple(from_plain(kind, value[i], f"{where}[{i}]") for i, kind in enumerate(kinds))
    if is_dataclass(hint):
        return _dataclass(hint, value, where, given)
    if origin is dict:
        _check(isinstance(value, dict), where, value, "an object")
        return value
    if hint is float:
        is_number = (
            isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        )
        _check(is_number, where, value, "a finite number")
        return float(value)
    _check(type(value) is hint, where, value, f"a value of type {hint.__name__}")
    return value


def _dataclass(hint: Any, value: Any, where: str, given: dict[str, Any]) -> Any:
    _check(isinstance(value, dict), where, value, "an object")
    # a document without a result does not load its type
    hints = get_type_hints(hint, localns={"Match": Any})
    known = {entry.name: entry for entry in fields(hint) if entry.name not in given}
    unknown = sorted(value.keys() - known.keys())
    _check(not unknown, where, unknown, f"only {', '.join(known)}")
    required = {
        name for name, e in known.items() if e.default is MISSING and e.default_factory is MISSING
    }
    missing = sorted(required - value.keys())
    _check(not missing, where, value, f"also {', '.join(missing)}")
    parts = {name: from_plain(hints[name], part, f"{where}.{name}") for name, part in value.items()}
    return hint.from_dict(parts) if hasattr(hint, "from_dict") else hint(**parts, **given)


def _check(fits: bool, where: str, value: Any, expected: str) -> None:
    if not fits:
        raise PlainError(f"{where} is {brief(value)}; expected {expected}")

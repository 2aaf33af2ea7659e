"""Entries of the JSON of glTF, of the types that it has them in."""

from typing import Any

import numpy as np

from abfm.types import FloatArray

_WORDS = {dict: "object", list: "array", int: "whole number", str: "text"}  # of JSON


def of(entry: Any, name: str, kind: type, default: Any) -> Any:
    """Return what a JSON object has under a name, of this type."""
    found = entry.get(name, default) if isinstance(entry, dict) else None
    if found is not default and (not isinstance(found, kind) or isinstance(found, bool)):
        raise ValueError(f"its {name} is no {_WORDS[kind]}, as glTF has it")
    return found


def indices_of(entry: dict[str, Any], name: str) -> list[int]:
    found: list[int] = of(entry, name, list, [])
    if not all(type(index) is int for index in found):
        raise ValueError(f"its {name} are no list of numbers, as glTF has it")
    return found


def numbers_of(entry: dict[str, Any], name: str, count: int, what: str = "node") -> FloatArray:
    """Return the numbers (count,) that a JSON object has under a name."""
    found = of(entry, name, list, None)
    are_numbers = found is not None and all(isinstance(each, int | float) for each in found)
    if not are_numbers or len(found) != count:
        raise ValueError(f"the {name} of a {what} is not made of {count} numbers")
    return np.array([float(each) for each in found])

"""What was made last, kept while what it is made of stays the same."""

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

Value = TypeVar("Value")


def same(one: object, other: object) -> bool:
    """Tell whether two things, or tuples of such, are equal; arrays only if they are one object,
    which costs nothing.
    """
    if one is other:
        return True
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return (
        not isinstance(one, np.ndarray) and not isinstance(other, np.ndarray) and bool(one == other)
    )


class Memo(Generic[Value]):
    """Remembers one value: asked for the same again, it gives the same object, by which others
    see no change.
    """

    def __init__(self) -> None:
        self._kept: tuple[tuple[object, ...], Value] | None = None

    def get(self, made_of: tuple[object, ...], make: Callable[[], Value]) -> Value:
        """The value made of these things (see `same`), made anew if it was of others."""
        if self._kept is None or not same(self._kept[0], made_of):
            self._kept = made_of, make()
        return self._kept[1]

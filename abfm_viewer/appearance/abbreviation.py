"""Texts that are cut where there is no room for them."""

from bisect import bisect
from collections.abc import Callable


def cut(text: str, room: float, width_of: Callable[[str], float]) -> str:
    """Return a text, or as much of it as has room, with an ellipsis; else nothing."""
    if width_of(text) <= room:
        return text

    def width(length: int) -> float:
        return width_of(text[:length].rstrip() + "...")

    too_long = bisect(range(len(text)), room, key=width)
    return text[: too_long - 1].rstrip() + "..." if too_long > 1 else ""

"""Texts that are cut where there is no room for them."""

from bisect import bisect
from collections.abc import Callable


def cut(text: str, room: float, width_of: Callable[[str], float]) -> str:
    """A text, or as much of it as has room, with an ellipsis; nothing where not even that has."""
    if width_of(text) <= room:
        return text
    too_long = bisect(range(len(text)), room, key=lambda length: width_of(text[:length].rstrip() + "..."))
    return text[: too_long - 1].rstrip() + "..." if too_long > 1 else ""

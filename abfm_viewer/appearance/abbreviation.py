"""Texts that are cut where there is no room for them."""

from __future__ import annotations

from collections.abc import Callable


def cut(text: str, room: float, width_of: Callable[[str], float]) -> str:
    """A text, or as much of it as has room, with an ellipsis; nothing where not even that has."""
    if width_of(text) <= room:
        return text
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        fits = width_of(text[:middle].rstrip() + "...") <= room
        low, high = (middle, high) if fits else (low, middle - 1)
    return text[:low].rstrip() + "..." if low else ""

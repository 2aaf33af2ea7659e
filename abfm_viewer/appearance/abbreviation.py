"""Texts that are cut where there is no room for them."""

from collections.abc import Callable


def cut(text: str, room: float, width_of: Callable[[str], float]) -> str:
    """A text, or as much of it as has room, with an ellipsis; nothing where not even that has."""
    if width_of(text) <= room:
        return text
    shorter = (text[:length].rstrip() + "..." for length in range(len(text), 0, -1))
    return next((one for one in shorter if width_of(one) <= room), "")

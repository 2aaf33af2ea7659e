"""Abbreviation of texts that do not fit."""

from bisect import bisect
from collections.abc import Callable


def abbreviated(text: str, width_max: float, width_of: Callable[[str], float]) -> str:
    """Return the text, shortened with an ellipsis to a width; empty if no letter fits."""
    if width_of(text) <= width_max:
        return text

    def width(length: int) -> float:
        return width_of(text[:length].rstrip() + "...")

    too_long = bisect(range(len(text)), width_max, key=width)
    return text[: too_long - 1].rstrip() + "..." if too_long > 1 else ""

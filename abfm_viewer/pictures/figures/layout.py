"""Where the panels and plots of a figure lie on its sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

WIDEST, TALLEST_PANEL, LOWEST_PANEL = 2000, 640, 240
# in pixels
MARGIN, GAP, LABEL, BARS = 30, 18, 46, 110


@dataclass(frozen=True)
class Place:
    """A rectangle of a sheet, in pixels from its upper left corner."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True)
class Layout:
    """Size of a sheet in pixels, the places of its cells row by row, and where the colour bars begin."""

    width: int
    height: int
    rows: tuple[tuple[Place, ...], ...]
    bars_top: int


def laid_out(rows: Sequence[Sequence[float]], bars: bool) -> Layout:
    """Give cells, of which the widths over the heights are given row by row, one height, as the widest row allows.

    Parameters
    ----------
    bars : bool
        Whether there are colour bars below.
    """
    height = min(TALLEST_PANEL, *(_room(row) / sum(row) for row in rows))
    wide = max(sum(_widths(row, height)) + GAP * (len(row) - 1) for row in rows)
    width = wide + 2 * MARGIN
    places, top = [], MARGIN
    for row in rows:
        widths = _widths(row, height)
        left = (width - sum(widths) - GAP * (len(row) - 1)) // 2
        line = []
        for cell in widths:
            line.append(Place(left, top, cell, round(height)))
            left += cell + GAP
        places.append(tuple(line))
        top += round(height) + LABEL + GAP
    return Layout(width, top + (BARS if bars else 0) - GAP + MARGIN // 2, tuple(places), top)


def _room(row: Sequence[float]) -> int:
    return WIDEST - 2 * MARGIN - GAP * (len(row) - 1)


def _widths(row: Sequence[float], height: float) -> list[int]:
    return [round(aspect * height) for aspect in row]

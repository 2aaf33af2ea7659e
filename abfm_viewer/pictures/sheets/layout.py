"""Where the panels, plots and colour bars of a sheet lie."""

from collections.abc import Sequence
from dataclasses import dataclass

from abfm_viewer.widgets.widget_record import Rect

WIDEST, TALLEST_PANEL = 2000, 640  # of sheets without a size, in pixels
# in pixels at a scale of 1
MARGIN, GAP, LABEL = 30, 18, 46
_BELOW, _BESIDE = 110, 100  # room of colour bars
_BAR_LENGTH, _UPRIGHT_LENGTH, _BAR_WIDTH, _BAR_GAP, _ABOVE, _BEFORE = 380, 560, 20, 90, 29, 22


@dataclass(frozen=True)
class Place:
    """A rectangle of a sheet, in pixels from its upper left corner."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True)
class Layout:
    """Size of a sheet in pixels, its scale, and places of its cells and colour bars."""

    width: int
    height: int
    scale: float
    rows: tuple[tuple[Place, ...], ...]
    bars: tuple[Rect, ...]
    upright: bool


def laid_out(
    rows: Sequence[Sequence[float]],
    bars: int,
    upright: bool = False,
    size: tuple[int | None, int | None] = (None, None),
    scale: float = 1.0,
) -> Layout:
    """Give cells, of which the widths over the heights are given row by row, one height, as large
    as there is room.

    So many colour bars are below, or one to the right if it is upright. The cells lie in the middle
    of the sheet, which without a size (width, height) is as large as its cells need: it is at most
    `WIDEST`, and they are at most `TALLEST_PANEL`. All other lengths are scaled.
    """
    width, height = size
    margin, gap, label = scale * MARGIN, scale * GAP, scale * LABEL
    beside, below = scale * _BESIDE * upright, scale * _BELOW * (bars > 0 and not upright)
    free = (width or WIDEST) - 2 * margin - beside
    tall = min((free - gap * (len(row) - 1)) / sum(row) for row in rows)
    if width is None:
        tall = min(tall, TALLEST_PANEL)
    if height is not None:
        tall = min(tall, (height - 1.5 * margin - below + gap) / len(rows) - label - gap)
    step = max(round(tall), 1) + label + gap
    widths = [[max(round(aspect * tall), 1) for aspect in row] for row in rows]
    totals = [sum(row) + gap * (len(row) - 1) for row in widths]
    width = width or round(max(totals) + 2 * margin + beside)
    top = margin if height is None else (height - below - len(rows) * step + gap) / 2
    places = []
    for number, (row, total) in enumerate(zip(widths, totals, strict=True)):
        left, line = (width - beside - total) / 2, []
        for cell in row:
            line.append(Place(int(left), int(top + number * step), cell, max(round(tall), 1)))
            left += cell + gap
        places.append(tuple(line))
    end = top + len(rows) * step
    height = height or round(end - gap + below + margin / 2)
    if upright:
        middle = (top + end - label - gap) / 2
        half = min((end - label - gap - top) / 2, scale * _UPRIGHT_LENGTH / 2)
        left = (width - beside + max(totals)) / 2 + scale * _BEFORE
        found = [(left, middle - half, left + scale * _BAR_WIDTH, middle + half)]
    else:
        each, high = (width - 2 * scale * _BAR_GAP) / max(bars, 1), end + scale * _ABOVE
        half = min(scale * _BAR_LENGTH, each - scale * _BAR_GAP / 2) / 2
        middles = [scale * _BAR_GAP + (number + 0.5) * each for number in range(bars)]
        found = [
            (middle - half, high, middle + half, high + scale * _BAR_WIDTH) for middle in middles
        ]
    return Layout(width, height, scale, tuple(places), tuple(found), upright)

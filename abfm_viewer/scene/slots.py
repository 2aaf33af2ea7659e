"""Where surfaces stand in the window: each in a slot of its own, with its name above it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from abfm_viewer.document.document import Layout
from abfm_viewer.widgets.widget_record import Rect

_MARGIN = 0.04  # of the smaller side, free on each side of a surface that fits
_FRONT, _FILLED = 0.8, 0.5  # what the front counts, and that no place stays empty
_LEAST = 8.0  # pixels that a surface has however little room there is
# name's share of a low slot's height; width of a wide one; name's share of that
_LOW, _WIDE, _BESIDE = 0.25, 2.0, 0.35


@dataclass(frozen=True)
class Slot:
    """A surface's part of the window: the surface is clipped to `rect`, and its name stands in
    `name`.

    That is above the surface, or at the left where the slot is too low for both.
    """

    rect: Rect
    name: Rect

    @property
    def middle(self) -> tuple[float, float]:
        """Return where the target of the surface is."""
        left, top, right, bottom = self.rect
        return (left + right) / 2, (top + bottom) / 2

    @property
    def half(self) -> tuple[float, float]:
        """From the middle to the sides, less the margins."""
        left, top, right, bottom = self.rect
        width, height = right - left, bottom - top
        margin = _MARGIN * min(width, height)
        return width / 2 - margin, height / 2 - margin


def slots(
    names: Sequence[str], rect: Rect, shape: tuple[float, float], layout: Layout, name_height: float
) -> dict[str, Slot]:
    """Slots that fill a rectangle of the window, row by row, all of one size; `shape` is the width
    and height of all.

    An automatic layout is one that makes them large. A last row with fewer of them stands in the
    middle.
    """
    count = len(names)
    if layout == "row":
        columns = count
    elif layout == "column":
        columns = 1
    else:
        columns = max(
            range(count, 0, -1),
            key=lambda columns: _goodness(columns, count, rect, shape, name_height),
        )
    return dict(zip(names, _grid(columns, count, rect, name_height), strict=True))


def _goodness(
    columns: int, count: int, rect: Rect, shape: tuple[float, float], name_height: float
) -> float:
    """Rate how large surfaces are from the front, and a little from any side."""
    half = next(_grid(columns, count, rect, name_height)).half
    filled = count / (columns * math.ceil(count / columns))
    return float(fitting(half, shape) ** _FRONT * min(half) ** (1 - _FRONT) * filled**_FILLED)


def fitting(half: tuple[float, float], shape: tuple[float, float]) -> float:
    """Return how much a shape (width, height) can be scaled to fit into half a width and height."""
    return min(2 * room / max(length, 1e-12) for room, length in zip(half, shape, strict=True))


def _grid(columns: int, count: int, rect: Rect, name_height: float) -> Iterator[Slot]:
    left, top, right, bottom = rect
    rows = math.ceil(count / columns)
    width, height = (right - left) / columns, (bottom - top) / rows
    for number in range(count):
        row, column = divmod(number, columns)
        in_row = min(columns, count - row * columns)
        x = left + (column + (columns - in_row) / 2) * width
        y = top + row * height
        if name_height > _LOW * height and width >= _WIDE * height:
            start = x + _BESIDE * width
            yield Slot(
                (start, y, x + width, y + height), (x, y, start, y + min(name_height, height))
            )
            continue
        head = max(min(name_height, height - _LEAST), 0.0)
        yield Slot((x, y + head, x + width, y + height), (x, y, x + width, y + head))

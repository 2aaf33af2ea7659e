"""Colour bars of windows, pictures and sheets: a strip with its title and numbers."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.colormaps import ColorRange
from abfm_viewer.appearance.theme import Color, Palette
from abfm_viewer.widgets.widget_record import Rect

GAP = 3  # between a bar and its texts, in pixels at a scale of 1
# strip in a line, and what a line is longer where there is room, likewise
_SHORTEST, _LONGEST = 30, 300
_APART = 16  # lines, likewise


@dataclass(frozen=True)
class Text:
    """A line of text by its left upper corner."""

    left: float
    top: float
    text: str
    color: Color


@dataclass(frozen=True)
class Strip:
    """A rectangle with the colours of a map from left to right, or upwards."""

    rect: Rect
    colormap: str
    upright: bool = False
    title: str = ""  # if there is no room to write it whole


@dataclass(frozen=True)
class Line:
    """A line through points (x, y)."""

    points: tuple[tuple[float, float], ...]
    color: Color
    width: float


Part = Text | Strip | Line


@dataclass(frozen=True)
class Pen:
    """How large things are written, and in which colours.

    Colour bars with ticks are outlined and have round numbers. Without ticks only the ends and the
    middle have numbers, and nothing stands out beyond the ends.
    """

    scale: float  # of all lengths but the text's
    line: float  # height of a line of text
    width: Callable[[str], float]  # of a text
    inks: Palette
    tick: float = 0.0  # length


def bar_parts(
    title: str, colors: ColorRange, rect: Rect, pen: Pen, upright: bool = False
) -> list[Part]:
    """Lay out a bar in a rectangle, its title above, its numbers below or to its right."""
    left, top, right, bottom = rect
    gap, inks = GAP * pen.scale, pen.inks
    is_cut = not upright and pen.width(title) > right - left
    found: list[Part] = [Strip(rect, colors.colormap, upright, title if is_cut else "")]
    if pen.tick:
        outline = ((left, top), (right, top), (right, bottom), (left, bottom), (left, top))
        found.append(Line(outline, inks.ink, pen.scale))
    if not upright:
        title = cut(title, right - left, pen.width)
        indent = (right - left - pen.width(title)) / 2 if pen.tick else 0.0
        found.append(Text(left + indent, top - gap - pen.line, title, inks.muted))
    length = bottom - top if upright else right - left
    round_numbers = _round_numbers(colors, length, pen, upright) if pen.tick else None
    for value in round_numbers or _ends_and_middle(colors, length, pen):
        text = f"{value:.4g}" if pen.tick else f"{value:.3g}"
        along = (value - colors.low) / (colors.high - colors.low) * length
        x, y = (right, bottom - along) if upright else (left + along, bottom)
        end = (x + pen.tick, y) if upright else (x, y + pen.tick)
        if pen.tick:
            found.append(Line(((x, y), end), inks.ink, pen.scale))
        if upright:
            found.append(Text(x + 2 * pen.tick, y - pen.line / 2, text, inks.ink))
            continue
        start = x - pen.width(text) / 2
        if not pen.tick:
            start = min(max(start, left), right - pen.width(text))
        found.append(Text(start, bottom + max(pen.tick, gap), text, inks.ink))
    return found


def bars_in_a_line(ranges: Mapping[str, ColorRange], rect: Rect, pen: Pen) -> list[Part]:
    """Lay out bars by their titles, as high as a line of text, between the ends of their ranges.

    Where there is little room titles are written up to a comma, or left away, the last ones first.
    """
    left, top, right, bottom = rect
    gap, apart, thin = 2 * GAP * pen.scale, _APART * pen.scale, pen.line / 4
    shortest, inks = _SHORTEST * pen.scale, pen.inks
    ends = [(f"{colors.low:.3g}", f"{colors.high:.3g}") for colors in ranges.values()]
    room = right - left - max(len(ranges) - 1, 0) * apart
    for titles in _shorter(list(ranges)):
        before = [pen.width(title) + 2 * gap if title else 0.0 for title in titles]
        needed = [
            shortest + pen.width(low) + pen.width(high) + 2 * gap + start
            for start, (low, high) in zip(before, ends, strict=True)
        ]
        if sum(needed) <= room:
            break
    spare = min((room - sum(needed)) / max(len(ranges), 1), _LONGEST * pen.scale)
    found: list[Part] = []
    for (whole, colors), title, (low, high), length in zip(
        ranges.items(), titles, ends, needed, strict=True
    ):
        begin = left + (pen.width(title) + 2 * gap if title else 0.0)
        stop = left + length + spare
        start, end = begin + pen.width(low) + gap, stop - pen.width(high) - gap
        strip = (start, top + thin, max(end, start), bottom - thin)
        found += [
            Text(left, top, title, inks.muted),
            Text(begin, top, low, inks.ink),
            Strip(strip, colors.colormap, title="" if title == whole else whole),
            Text(stop - pen.width(high), top, high, inks.ink),
        ]
        left = stop + apart
    return found


def _shorter(titles: list[str]) -> Iterator[list[str]]:
    """The titles, and ever less of them."""
    yield titles
    short = [title.split(",")[0] for title in titles]
    for count in range(len(titles), -1, -1):
        yield [*short[:count], *("" for _ in short[count:])]


def _ends_and_middle(colors: ColorRange, length: float, pen: Pen) -> list[float]:
    """Without the middle where it would be crowded."""
    ends = [colors.low, (colors.low + colors.high) / 2, colors.high]
    first, middle, last = (pen.width(f"{value:.3g}") for value in ends)
    crowded = (length - middle) / 2 < max(first, last) + pen.line / 2
    return ends[::2] if crowded else ends


def _round_numbers(colors: ColorRange, length: float, pen: Pen, upright: bool) -> list[float]:
    """Choose of a range's ticks all, or every second, third, ... so that numbers stand apart."""
    values = ticks(colors.low, colors.high)
    step = values[1] - values[0]
    widest = max(pen.width(f"{value:.4g}") for value in values)
    needed = pen.line if upright else widest + pen.line / 2
    every = math.ceil(needed * (colors.high - colors.low) / (step * length))
    return [value for value in values if round(value / step) % every == 0]


def ticks(low: float, high: float) -> list[float]:
    """Three to seven round numbers between two values."""
    rough = (high - low) / 6
    power = 10 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= rough)
    return [
        step * k for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    ]

"""Annotations over the surfaces: names, colour bars, landmarks and rings around Gaussians."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import polyscope.imgui as imgui

from abfm import FunctionError
from abfm.pages.color_ranges import ticks
from abfm.pages.colormaps import NO_VALUES, ColorRange, table
from abfm.pages.front import triple
from abfm.pages.sequence_motion import CRITICAL_COLORS
from abfm.types import FloatArray
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.appearance.theme import LANDMARKS, ON_LANDMARKS, Color, Palette
from abfm_viewer.computing.background import Memo
from abfm_viewer.document import gaussians
from abfm_viewer.document.document import SIDES, Side
from abfm_viewer.scene.scene import FAINT_TEXT, LANDMARK_RADIUS, NO_VALUE, DrawnLandmark, Scene
from abfm_viewer.session.active_gaussian import active_gaussian
from abfm_viewer.session.session import Session
from abfm_viewer.shown.paint import COMPUTING_SUFFIX
from abfm_viewer.widgets.containers import is_mouse_in
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_STEPS = 64  # colours of a bar
_ARROW = 0.8  # length of the arrow at a clipped end of a bar, relative to the bar's width
# The following lengths are in pixels at a scale of 1.
_GAP = 3  # between a bar and its texts
_BAR_WIDTH = 200
_BAR_HEIGHT = 12
_BAR_GAP = 48
TICK = 3
_MARGIN = 18
_GAP_BELOW = 14
_GAP_ABOVE = 10
_STRIP_LENGTH_MIN = 30  # minimum length of a colour bar in one line of text
_STRIP_GROWTH_MAX = 300
_LINE_GAP = 16  # between colour bars in one line of text
_LINK_WIDTH = 1.2
_INK_SHARE = 0.35  # of the colour of texts in the colours of links
_DOT_RADIUS = 5.0
_RING_RADIUS = 9.0
_RING_WIDTH = 2.0
_BAR_HEIGHT_SHARE_MAX = 0.25  # of the height; in less space each bar is one line of text
_VEIL_OPACITY = 0.6
_GREY = NO_VALUES ** (1 / 2.2)
_LEGEND = {
    **CRITICAL_COLORS,
    NO_VALUE: (_GREY, _GREY, _GREY, 1.0),
    FAINT_TEXT: (_GREY, _GREY, _GREY, 0.35),
}
_SHORT_TEXTS = {FAINT_TEXT: "undetermined"}


@dataclass(frozen=True)
class Text:
    left: float
    top: float
    text: str
    color: Color


@dataclass(frozen=True)
class Strip:
    """A rectangle with the colours of a colormap, from left to right or from bottom to top."""

    rect: Rect
    colormap: str
    upright: bool = False
    title: str = ""  # tooltip: the full title and values, if they are not visible


@dataclass(frozen=True)
class Triangle:
    points: tuple[tuple[float, float], ...]
    color: Color


@dataclass(frozen=True)
class Line:
    points: tuple[tuple[float, float], ...]
    color: Color
    width: float


@dataclass(frozen=True)
class Disc:
    """A disc, or a ring if the radius of its hole is not 0."""

    centre: tuple[float, float]
    radius: float
    color: Color
    hole: float = 0.0


@dataclass(frozen=True)
class Veil:
    """A rectangle that dims everything below it."""

    rect: Rect
    color: Color


Part = Text | Strip | Triangle | Line | Disc | Veil


@dataclass(frozen=True)
class Pen:
    """Sizes and colours of annotations."""

    scale: float  # of all lengths except those of text
    line: float  # height of a line of text
    width: Callable[[str], float]  # of a text
    inks: Palette
    tick: float  # length of the ticks of colour bars


def bar_parts(
    title: str, colors: ColorRange, rect: Rect, pen: Pen, upright: bool = False
) -> list[Part]:
    """Lay out a colour bar: title above and numbers below, or upright with numbers at the right.

    An arrow points beyond each end where values are clipped.
    """
    left, top, right, bottom = rect
    gap, inks = _GAP * pen.scale, pen.inks
    shown_title = title if upright else abbreviated(title, right - left, pen.width)
    tip = _bar_tip(title, shown_title, colors)
    found: list[Part] = [Strip(rect, colors.colormap, upright, tip)]
    arrows = _arrows(colors, rect, upright)
    found += filter(None, arrows)
    before, after = ([arrow.points[1]] if arrow else [] for arrow in arrows)
    corners = [(left, top), *before, (left, bottom), (right, bottom), *after, (right, top)]
    if upright:
        corners = [(left, top), *after, (right, top), (right, bottom), *before, (left, bottom)]
    found.append(Line((*corners, corners[0]), inks.ink, pen.scale))
    if not upright:
        indent = (right - left - pen.width(shown_title)) / 2
        found.append(Text(left + indent, top - gap - pen.line, shown_title, inks.muted))
    length = bottom - top if upright else right - left
    for value in _numbers(colors, length, pen, upright):
        text = f"{value:.4g}"
        along = (value - colors.low) / (colors.high - colors.low) * length
        x, y = (right, bottom - along) if upright else (left + along, bottom)
        end = (x + pen.tick, y) if upright else (x, y + pen.tick)
        found.append(Line(((x, y), end), inks.ink, pen.scale))
        if upright:
            found.append(Text(x + 2 * pen.tick, y - pen.line / 2, text, inks.ink))
        else:
            start = x - pen.width(text) / 2
            found.append(Text(start, bottom + max(pen.tick, gap), text, inks.ink))
    return found


def _bar_tip(title: str, shown: str, colors: ColorRange) -> str:
    if any(colors.clipped):
        low, high = colors.full
        return f"{title}: values from {low:.4g} to {high:.4g}"
    return "" if title == shown else title


def _arrows(colors: ColorRange, rect: Rect, upright: bool = False) -> list[Triangle | None]:
    """Return the arrows beyond the low and the high end of a bar; None where nothing is clipped."""
    left, top, right, bottom = rect
    size, middle = (right - left, (left + right) / 2) if upright else (bottom - top, 0.0)
    found: list[Triangle | None] = []
    for is_clipped, is_high in zip(colors.clipped, (False, True), strict=True):
        at, sign = (right if is_high else left), (1 if is_high else -1)
        base = at - sign  # overlaps the bar by a pixel
        points = ((base, top), (at + sign * _ARROW * size, (top + bottom) / 2), (base, bottom))
        if upright:
            at = top if is_high else bottom
            base = at + sign
            points = ((left, base), (middle, at - sign * _ARROW * size), (right, base))
        color = (*triple(table(colors.colormap, _STEPS)[-1 if is_high else 0]), 1.0)
        found.append(Triangle(points, color) if is_clipped else None)
    return found


def bars_in_one_line(ranges: Mapping[str, ColorRange], rect: Rect, pen: Pen) -> list[Part]:
    """Lay out colour bars in one line of text; shorten or omit titles that do not fit."""
    left, top, right, bottom = rect
    gap, separation, thin = 2 * _GAP * pen.scale, _LINE_GAP * pen.scale, pen.line / 4
    inks, full_titles, count = pen.inks, list(ranges), len(ranges)
    ends = [(f"{colors.low:.3g}", f"{colors.high:.3g}") for colors in ranges.values()]
    shortest = _STRIP_LENGTH_MIN * pen.scale
    lengths_min = [shortest + pen.width(low) + pen.width(high) + 2 * gap for low, high in ends]
    available = right - left - max(count - 1, 0) * separation
    short = [title.split(",")[0] for title in full_titles]
    for titles in (full_titles, *(short[:k] + [""] * (count - k) for k in range(count, -1, -1))):
        starts = [pen.width(title) + 2 * gap if title else 0.0 for title in titles]
        needed = list(map(sum, zip(lengths_min, starts, strict=True)))
        if sum(needed) <= available:
            break
    growth = min((available - sum(needed)) / max(count, 1), _STRIP_GROWTH_MAX * pen.scale)
    found: list[Part] = []
    for (full_title, colors), title, (low, high), before, length in zip(
        ranges.items(), titles, ends, starts, needed, strict=True
    ):
        begin, stop = left + before, left + length + growth
        start, end = begin + pen.width(low) + gap, stop - pen.width(high) - gap
        strip = (start, top + thin, max(end, start), bottom - thin)
        found += [
            Text(left, top, title, inks.muted),
            Text(begin, top, low, inks.ink),
            Strip(strip, colors.colormap, title=_bar_tip(full_title, title, colors)),
            *filter(None, _arrows(colors, strip)),
            Text(stop - pen.width(high), top, high, inks.ink),
        ]
        left = stop + separation
    return found


def _numbers(colors: ColorRange, length: float, pen: Pen, upright: bool) -> list[float]:
    """Return the round numbers next to a colour bar, as many as fit, and if possible two."""
    values = ticks(colors.low, colors.high)
    step = values[1] - values[0]
    widest = max(pen.width(f"{value:.4g}") for value in values)
    needed = pen.line if upright else widest + pen.line / 2
    every = math.ceil(needed * (colors.high - colors.low) / (step * length))
    found = [value for value in values if round(value / step) % every == 0]
    two_fit = (values[-1] - values[0]) / (colors.high - colors.low) * length >= needed
    return found if len(found) > 1 or not two_fit else [values[0], values[-1]]


def bars_height(pen: Pen, height: float) -> float:
    """Return the height of colour bars, with titles and numbers, in a scene of a given height."""
    bars = 2 * pen.line + pen.scale * (_GAP_ABOVE + _BAR_HEIGHT + 2 * _GAP + _GAP_BELOW)
    return bars if bars <= _BAR_HEIGHT_SHARE_MAX * height else name_height(pen)


def name_height(pen: Pen) -> float:
    return pen.line + 4 * _GAP * pen.scale


def annotation_parts(
    scene: Scene, rect: Rect, pen: Pen, color_bar: bool = True, labels: bool = True
) -> list[Part]:
    borders = scene.view.borders() if scene.shown else []
    outdated, veil = scene.outdated, (*pen.inks.ground[:3], _VEIL_OPACITY)
    found: list[Part] = [Veil(scene.view.slots[name].rect, veil) for name in outdated]
    found += [Line(ends, pen.inks.border, pen.scale) for ends in borders]
    links = scene.links()
    for place, other, color in links:
        distinct = color + _INK_SHARE * (np.array(pen.inks.ink[:3]) - color)  # from the background
        found.append(Line((place, other), (*triple(distinct), 1.0), _LINK_WIDTH * pen.scale))
    found += landmark_parts(scene.landmarks(), pen)
    # names are centred above the surfaces, or aligned at their left
    for name, title, (left, top, right, bottom) in _titles(scene) if labels else ():
        title = abbreviated(title, right - left - 4 * pen.scale, pen.width)
        length = pen.width(title)
        start = right - length if scene.view.has_names_at_left else (left + right - length) / 2
        ink = {"source": pen.inks.source, "target": pen.inks.target}.get(name, pen.inks.ink)
        if links:  # they may cross the name
            found.append(Veil((start, top, start + length, bottom), (*pen.inks.ground[:3], 0.85)))
        found.append(Text(start, (top + bottom - pen.line) / 2, title, ink))
    if color_bar:
        kinds = scene.legend()
        full, short = (_legend(kinds, rect, pen, texts) for texts in ({}, _SHORT_TEXTS))
        # colour bars leave space for a legend in the right half
        is_narrow = _left_end(short, rect) > (rect[0] + rect[2]) / 2
        right = _left_end(short, rect) if is_narrow else rect[2]
        bars = _bars(scene, (*rect[:2], right, rect[3]), pen)
        end = _right_end(bars, rect, pen)
        found += bars
        found += next((parts for parts in (full, short) if _left_end(parts, rect) > end), [])
    return found


def _right_end(parts: Sequence[Part], rect: Rect, pen: Pen) -> float:
    """Return the right end of all strips and texts; without any, the left side of the rectangle."""
    ends = [one.rect[2] for one in parts if isinstance(one, Strip)]
    ends += [one.left + pen.width(one.text) for one in parts if isinstance(one, Text)]
    return max(ends, default=rect[0])


def _left_end(legend: Sequence[Part], rect: Rect) -> float:
    """Return the left end of a legend; if it is empty, the right side of the rectangle."""
    ends = [one.centre[0] - one.radius for one in legend if isinstance(one, Disc)]
    return min(ends, default=rect[2])


def _legend(kinds: Sequence[str], rect: Rect, pen: Pen, texts: Mapping[str, str]) -> list[Part]:
    """Lay out the legend at the right; ``texts`` replace the names of some kinds."""
    radius, top = _DOT_RADIUS * pen.scale, rect[3] - bars_height(pen, rect[3] - rect[1]) / 2
    found, right = list[Part](), rect[2] - _MARGIN * pen.scale
    for kind in reversed(kinds):
        text = texts.get(kind, kind)
        right -= pen.width(text)
        found.append(Text(right, top - pen.line / 2, text, pen.inks.ink))
        right -= 2 * radius
        found.append(Disc((right, top), radius, _LEGEND[kind]))
        right -= radius + _LINE_GAP * pen.scale
    return found


def landmark_parts(landmarks: Sequence[DrawnLandmark], pen: Pen) -> list[Part]:
    """Lay out landmarks as numbered discs, and the places that they should reach as rings."""
    found: list[Part] = []
    radius, line = LANDMARK_RADIUS * pen.scale, 1.5 * pen.scale
    for landmark in sorted(landmarks, key=lambda each: not each.is_goal):  # rings below discs
        color, at = LANDMARKS[landmark.number % len(LANDMARKS)], landmark.place
        if landmark.is_goal:
            found.append(Disc(at, radius + line, ON_LANDMARKS, radius - 2 * line))
            found.append(Disc(at, radius, color, radius - line))
            continue
        text = str(landmark.number + 1)
        found.append(Disc(at, radius + line, ON_LANDMARKS))
        found.append(Disc(at, radius, color))
        corner = at[0] - pen.width(text) / 2, at[1] - pen.line / 2
        found.append(Text(*corner, text, ON_LANDMARKS))
    return found


def _titles(scene: Scene) -> Iterator[tuple[str, str, Rect]]:
    outdated = scene.outdated
    for name in scene.shown:
        paint = scene.paints.get(name)
        title = paint.title if paint else name
        if paint is None or name in outdated:
            title = f"{title.partition(': ')[0]}{COMPUTING_SUFFIX}"
        yield name, title, scene.view_of(name).label(name)


def _bars(scene: Scene, rect: Rect, pen: Pen) -> list[Part]:
    paints = [scene.paints[name] for name in scene.shown if name in scene.paints]
    ranges = {paint.bar: paint.colors for paint in paints if paint.colors is not None}
    left, gap = rect[0] + _MARGIN * pen.scale, _BAR_GAP * pen.scale
    end = rect[2] - _MARGIN * pen.scale
    bottom = rect[3] - (_GAP_BELOW + _GAP) * pen.scale - pen.line
    covered = bars_height(pen, rect[3] - rect[1])
    if covered < 2 * pen.line:
        top = rect[3] - (covered + pen.line) / 2
        line = (left, top, rect[2] - _MARGIN * pen.scale / 2, top + pen.line)
        return bars_in_one_line(ranges, line, pen)
    found: list[Part] = []
    top = bottom - _BAR_HEIGHT * pen.scale
    for number, (title, colors) in enumerate(ranges.items()):
        others = len(ranges) - number - 1
        width_max = max((end - left - others * gap) / (others + 1), gap)
        right = left + min(max(_BAR_WIDTH * pen.scale, pen.width(title)), width_max)
        found += bar_parts(title, colors, (left, top, right, bottom), pen)
        left = right + gap
    return found


def window_pen(ui: Ui) -> Pen:
    line = imgui.GetTextLineHeight()
    return Pen(ui.scale, line, ui.text_width, ui.colors, TICK * ui.scale)


def draw_annotations(ui: Ui, scene: Scene, rect: Rect, color_bar: bool = True) -> None:
    """Draw the annotations of a scene in the window, and the tooltips of abbreviated titles."""
    canvas = imgui.GetBackgroundDrawList()
    pen = window_pen(ui)
    parts = annotation_parts(scene, rect, pen, color_bar)
    show_full_title(scene, parts, pen)
    for one in parts:
        if isinstance(one, Veil):
            canvas.AddRectFilled(one.rect[:2], one.rect[2:], _u32(one.color))
        elif isinstance(one, Text):
            canvas.AddText((one.left, one.top), _u32(one.color), one.text)
        elif isinstance(one, Triangle):
            canvas.AddTriangleFilled(*one.points, _u32(one.color))
        elif isinstance(one, Line):
            for start, end in pairwise(one.points):
                canvas.AddLine(start, end, _u32(one.color), one.width)
        elif isinstance(one, Disc):
            width = one.radius - one.hole
            if one.hole:
                canvas.AddCircle(one.centre, one.hole + width / 2, _u32(one.color), 0, width)
            else:
                canvas.AddCircleFilled(one.centre, one.radius, _u32(one.color))
        else:
            _draw_strip(canvas, one)


def _draw_strip(canvas: Any, strip: Strip) -> None:
    left, top, right, bottom = strip.rect
    edges = np.linspace(left, right, _STEPS + 1)
    for color, start, end in zip(_shades(strip.colormap), edges[:-1], edges[1:], strict=True):
        canvas.AddRectFilled((start, top), (end + 0.5, bottom), color)


def show_full_title(scene: Scene, parts: Sequence[Part], pen: Pen) -> None:
    """Show a tooltip with the full title if the mouse is over an abbreviated one."""
    if imgui.GetIO().WantCaptureMouse:
        return
    x, y = imgui.GetMousePos()
    names = [
        (title, rect, 0.0)
        for _, title, rect in _titles(scene)
        if pen.width(title) > rect[2] - rect[0] - 4 * pen.scale
    ]
    bars = [(one.title, one.rect, pen.line) for one in parts if isinstance(one, Strip)]
    for title, (left, top, right, bottom), around in [*names, *bars]:
        is_at = left - around <= x < right + around and top - around <= y < bottom + around
        if title and is_at:
            imgui.SetTooltip(title)


@cache
def _shades(colormap: str) -> list[int]:
    return [_u32((*triple(color), 1.0)) for color in table(colormap, _STEPS)]


def _u32(color: Color) -> int:
    return int(imgui.GetColorU32(color))


Centre = tuple[FloatArray, FloatArray]  # A point (3,) and the normal (3,) of the surface there


class GaussianMarkers:
    """Rings around active Gaussians, drawn while Shift is held or if a side has several."""

    def __init__(self) -> None:
        self._centres = {side: Memo[Centre | None]() for side in SIDES}

    def draw(self, ui: Ui, session: Session, scene: Scene, rect: Rect) -> None:
        if session.values("source") is None and session.values("target") is None:
            return
        has_shift = imgui.GetIO().KeyShift and is_mouse_in(rect)
        canvas = imgui.GetBackgroundDrawList()
        for side in SIDES:
            if side not in scene.shown or not (found := self._centre(session, side, has_shift)):
                continue
            place, normal = found
            x, y, _ = scene.projected(side, place)[0]
            left, top, right, bottom = scene.view.slots[side].rect
            is_in_front = scene.view_of(side).rotation[2] @ normal > 0
            if is_in_front and left <= x <= right and top <= y <= bottom:
                rings = (2 * _RING_WIDTH, ui.colors.ground), (_RING_WIDTH, ui.colors.ink)
                for width, color in rings:
                    canvas.AddCircle((x, y), ui.px(_RING_RADIUS), _u32(color), 0, ui.px(width))

    def _centre(self, session: Session, side: Side, has_shift: bool) -> Centre | None:
        chosen, mesh = active_gaussian(session, side), session.surface(side).mesh
        if chosen is None or session.active is None:
            return None
        spec = session.active.spec(side)
        if gaussians.is_mapped(spec) or not (has_shift or len(gaussians.gaussians(spec)) > 1):
            return None

        def centre() -> Centre | None:
            with suppress(FunctionError):
                vertex = gaussians.gaussians(spec)[chosen].sources(mesh)[0]
                around = mesh.faces[(mesh.faces == vertex).any(axis=1)]
                a, b, c = np.moveaxis(mesh.vertices[around], 1, 0)
                return mesh.vertices[vertex], np.cross(b - a, c - a).sum(axis=0)
            return None

        return self._centres[side].get((mesh, spec, chosen), centre)

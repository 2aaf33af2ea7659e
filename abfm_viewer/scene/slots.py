"""Slots (rectangles of the window with one surface each), their views, and changes by the mouse."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from abfm.pages.front import Front, triple
from abfm.types import FloatArray
from abfm_viewer.document.document import ZOOM_MAX, ZOOM_MIN, Layout
from abfm_viewer.widgets.widget_record import Rect

_MARGIN = 0.04  # on each side of a surface, relative to the smaller side of the slot
# exponents of the front view's size and of the share of used slots in the rating of a layout
_FRONT_POWER = 0.8
_FILL_POWER = 0.5
_SURFACE_PIXELS_MIN = 8.0  # height of a surface in any window
# A wide slot that is too low for a name above the surface has it at the left.
_NAME_HEIGHT_SHARE = 0.25  # of the height of the slot, maximum for a name above
_WIDTH_RATIO_MIN = 2.0  # width over height of a wide slot
_NAME_WIDTH_SHARE = 0.35  # of the width of the slot, for a name at the left
_BALL = 0.8  # radius of the ball that the mouse turns, relative to that of the surface
_TILT_MAX = math.pi / 2

Place = tuple[float, float]  # A point of the window, in pixels


@dataclass(frozen=True)
class Slot:
    """The rectangle in which a surface is drawn and clipped, and the rectangle of its name."""

    rect: Rect
    name: Rect  # above or at the left

    @property
    def middle(self) -> Place:
        left, top, right, bottom = self.rect
        return (left + right) / 2, (top + bottom) / 2

    @property
    def half(self) -> tuple[float, float]:
        """Half the width and half the height of the rectangle without its margins, in pixels."""
        left, top, right, bottom = self.rect
        width, height = right - left, bottom - top
        margin = _MARGIN * min(width, height)
        return width / 2 - margin, height / 2 - margin


Slots = Mapping[str, Slot]


def slots(
    names: Sequence[str], rect: Rect, shape: tuple[float, float], layout: Layout, name_height: float
) -> dict[str, Slot]:
    """Divide a rectangle of the window into rows of slots, one slot for each name of a surface.

    ``shape`` is the width and height of the surfaces seen from the front. The automatic layout
    chooses the number of columns that makes the surfaces large.
    """
    count = len(names)

    def goodness(columns: int) -> float:
        """Rate a number of columns by the size of the surfaces and the share of used slots."""
        half = next(_grid(columns, count, rect, name_height)).half
        filled = count / (columns * math.ceil(count / columns))
        return float(
            fitting(half, shape) ** _FRONT_POWER
            * min(half) ** (1 - _FRONT_POWER)
            * filled**_FILL_POWER
        )

    columns = {"row": count, "column": 1}.get(layout) or max(range(count, 0, -1), key=goodness)
    return dict(zip(names, _grid(columns, count, rect, name_height), strict=True))


def fitting(half: tuple[float, float], shape: tuple[float, float]) -> float:
    """Return the scale at which a shape fits a slot; ``half`` has half the slot's sizes."""
    return min(2 * space / max(length, 1e-12) for space, length in zip(half, shape, strict=True))


def _grid(columns: int, count: int, rect: Rect, name_height: float) -> Iterator[Slot]:
    left, top, right, bottom = rect
    rows = math.ceil(count / columns)
    width, height = (right - left) / columns, (bottom - top) / rows
    for number in range(count):
        row, column = divmod(number, columns)
        in_row = min(columns, count - row * columns)
        x, y = left + (column + (columns - in_row) / 2) * width, top + row * height
        end, low = x + width, y + height
        if name_height > _NAME_HEIGHT_SHARE * height and width >= _WIDTH_RATIO_MIN * height:
            start = x + _NAME_WIDTH_SHARE * width
            yield Slot((start, y, end, low), (x, y, start, y + min(name_height, height)))
        else:
            head = max(min(name_height, height - _SURFACE_PIXELS_MIN), 0.0)
            yield Slot((x, y + head, end, low), (x, y, end, y + head))


@dataclass(frozen=True, eq=False)
class SlotView:
    """The view of surfaces in their slots, in parallel projection.

    A place is a position in the window, in pixels. Points have the coordinates in which a surface
    is drawn. The methods for actions of the mouse return a new view.
    """

    slots: Slots
    rotation: FloatArray  # (3, 3): its rows point right, up, and towards the viewer
    target: FloatArray  # (3,): the point in the middle of the slots
    centre: FloatArray  # (3,): the target that shows the surface in the middle of its slot
    upright: FloatArray  # (3,): the axis that points up in the front view
    zoom: float
    scale: float  # pixels per unit length
    radius: float  # of the surface, about the centre
    above: float  # extent of the surface upwards from the centre in this view

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Return window positions and depths (smaller: nearer), (P, 3), of points (P, 3)."""
        x, y, z = ((np.atleast_2d(points) - self.target) @ self.rotation.T).T
        middle = self.slots[name].middle
        return np.stack([middle[0] + self.scale * x, middle[1] - self.scale * y, -z], axis=1)

    def matrix(self, name: str, window: tuple[int, int], scale: float) -> FloatArray:
        """Return the transform (4, 4) that moves a surface into its slot.

        The viewer looks along z. A unit of length has ``scale`` pixels.
        """
        matrix, share = np.eye(4), self.scale / scale
        matrix[:3, :3], matrix[:3, 3] = self.rotation, -self.rotation @ self.target
        matrix[:3] *= share
        matrix[:2, 3] += share * self.drawn(self.slots[name].middle, window)
        return matrix

    def drawn(self, place: Place, window: tuple[int, int]) -> FloatArray:
        """Return a position relative to the window's middle, in units of drawn points, (2,)."""
        return np.array([place[0] - window[0] / 2, window[1] / 2 - place[1]]) / self.scale

    @property
    def is_clipped(self) -> bool:
        """Whether the surfaces may be larger than their slots, which then clip them."""
        return self.zoom > 1 or bool(np.abs(self.target - self.centre).max() > 1e-9 * self.radius)

    @property
    def has_names_at_left(self) -> bool:
        """Whether the names of surfaces are at their left; otherwise the names are above them."""
        slot = next(iter(self.slots.values()))
        return slot.name[3] > slot.rect[1] + 1

    def label(self, name: str) -> Rect:
        """Return the rectangle of a surface's name in its slot, close to the surface."""
        slot, (x, y, _) = self.slots[name], self.projected(name, self.centre)[0].tolist()
        left, top, right, bottom = slot.name
        if self.has_names_at_left:
            return left, top, min(max(x - self.scale * self.radius, right), slot.rect[2]), bottom
        end = min(max(y - self.scale * self.above, bottom), slot.rect[3])
        return left, end - (bottom - top), right, end

    def borders(self) -> list[tuple[Place, Place]]:
        """Return the lines between the slots of clipped surfaces; none if nothing is clipped."""
        if not self.is_clipped:
            return []
        rects = [(*slot.name[:2], *slot.rect[2:]) for slot in self.slots.values()]
        start, first = min(left for left, *_ in rects), min(top for _, top, _, _ in rects)
        end = max(right for _, _, right, _ in rects)
        sides = {(x, top, low) for left, top, right, low in rects for x in (left, right)}
        down = [((x, top), (x, low)) for x, top, low in sorted(sides) if start < x < end]
        tops = sorted({top for _, top, _, _ in rects} - {first})
        return [*down, *(((start, top), (end, top)) for top in tops)]

    def slot_at(self, place: Place) -> str:
        """Return the name of the surface whose slot contains a position, or is nearest to it."""

        def distance(name: str) -> float:
            left, top, right, bottom = self.slots[name].rect
            horizontal = max(left - place[0], 0, place[0] - right)
            return math.hypot(horizontal, max(top - place[1], 0, place[1] - bottom))

        return min(self.slots, key=distance)

    def turned(self, name: str, start: Place, end: Place) -> Self:
        """Return the view after a drag that turns a virtual ball around a surface."""
        one, other = (self._on_ball(name, place) for place in (start, end))
        axis = np.cross(one, other)
        sine = float(np.linalg.norm(axis))
        if sine < 1e-12:
            return self
        turn = rotation(axis / sine, math.atan2(sine, float(one @ other)))
        return replace(self, rotation=_orthonormal(turn @ self.rotation))

    def orbited(self, delta: Place) -> Self:
        """Return the view after a drag: horizontal motion turns it, vertical motion tilts it."""
        radian = _BALL * self.radius * self.scale / self.zoom
        _, up, towards = self.rotation @ self.upright
        before = math.atan2(towards, up)
        after = before + delta[1] / radian
        if abs(before) <= _TILT_MAX + 1e-6:  # the user may have turned it upside down before
            after = min(max(after, -_TILT_MAX), _TILT_MAX)
        around = rotation(self.rotation @ self.upright, delta[0] / radian)
        tilt = rotation(np.array([1.0, 0.0, 0.0]), after - before)
        return replace(self, rotation=_orthonormal(tilt @ around @ self.rotation))

    def moved(self, delta: Place) -> Self:
        """Return the view after a move by ``delta`` pixels; the surfaces stay in the window."""
        shift = np.array([-delta[0], delta[1], 0.0]) / self.scale
        away = self.target + shift @ self.rotation - self.centre
        share = min(1.0, self.radius / max(float(np.linalg.norm(away)), 1e-12))
        return replace(self, target=self.centre + away * share)

    def zoomed(self, name: str, place: Place, factor: float) -> Self:
        """Return the view zoomed about a place; zooming out also moves surfaces to the middle."""
        zoom = min(max(self.zoom * factor, ZOOM_MIN), ZOOM_MAX)
        if zoom < self.zoom:
            share = max(0.0, 1 - 1 / zoom) / (1 - 1 / self.zoom) if self.zoom > 1 else 1.0
            target = self.centre + share * (self.target - self.centre)
            return replace(self, zoom=zoom, target=target)
        middle = self.slots[name].middle
        away = np.array([place[0] - middle[0], middle[1] - place[1], 0.0]) / self.scale
        target = self.target + (1 - self.zoom / zoom) * away @ self.rotation
        return replace(self, zoom=zoom, target=target)

    def transferred(self, front: Front, fit: Fit, other: Front) -> SlotView:
        """Return the view of another surface that corresponds to this view.

        ``front`` is the front of this surface. ``fit`` and ``other`` are the extent and the front
        of the other surface.
        """
        axes = self.rotation @ front.axes.T @ other.axes
        view = fit.view(self.slots, Front(triple(axes[2]), triple(axes[1])), self.zoom, None)
        moved = front.axes @ (self.target - self.centre) * (self.scale / view.scale)
        return replace(view, target=view.centre + moved @ other.axes)

    def _on_ball(self, name: str, place: Place) -> FloatArray:
        """Return the unit vector (3,) to the point of a virtual ball below a place.

        Outside the ball, the point is on a hyperboloid around it.
        """
        middle, radius = self.slots[name].middle, _BALL * self.radius * self.scale
        x, y = (place[0] - middle[0]) / radius, (middle[1] - place[1]) / radius
        square = x * x + y * y
        point = np.array([x, y, np.sqrt(1 - square) if square < 0.5 else 0.5 / np.sqrt(square)])
        return np.asarray(point / np.linalg.norm(point))


def rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Return the matrix (3, 3) of the rotation about a unit axis (3,), by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def _orthonormal(rotation: FloatArray) -> FloatArray:
    """Return a rotation matrix (3, 3) made orthonormal again after rounding errors."""
    direction, right = rotation[2], np.cross(rotation[1], rotation[2])
    direction, right = direction / np.linalg.norm(direction), right / np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])


class Fit:
    """The extent of points (P, 3) of a surface, which gives its scale and middle in a slot."""

    def __init__(self, points: FloatArray, front: Front) -> None:
        axes = front.axes
        low, high = (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)
        self.shape: tuple[float, float] = (float(high[0] - low[0]), float(high[1] - low[1]))
        self._centre: FloatArray = (low + high) / 2 @ axes
        self._upright = axes[1]
        self._around = points - self._centre
        self._radius = float(np.linalg.norm(self._around, axis=1).max())
        self._last: tuple[Front, FloatArray, FloatArray, tuple[float, float]] | None = None

    def view(self, slots: Slots, front: Front, zoom: float, target: FloatArray | None) -> SlotView:
        """Return the view of the surface from a front, with ``target`` (3,) in the middle."""
        if self._last is None or self._last[0] != front:  # most frames have the same front
            axes = front.axes
            seen = self._around @ axes[:2].T
            low, high = seen.min(axis=0), seen.max(axis=0)
            width, height = (high - low).tolist()
            self._last = front, axes, self._centre + (low + high) / 2 @ axes[:2], (width, height)
        _, axes, centre, size = self._last
        half = next(iter(slots.values())).half
        scale = zoom * min(fitting(half, self.shape), fitting(half, size))
        target = centre if target is None else target
        sizes = zoom, scale, self._radius, size[1] / 2
        return SlotView(slots, axes, target, centre, self._upright, *sizes)

"""Where surfaces stand in the window, how they are seen there, and what turns and moves them."""

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

_MARGIN = 0.04  # of the smaller side, free on each side of a surface that fits
# what the front counts, and that no place stays empty
_FRONT_POWER = 0.8
_FILL_POWER = 0.5
_SURFACE_PIXELS_MIN = 8.0  # pixels that a surface has however little room there is
# name's share of a low slot's height; width of a wide one; name's share of that
_NAME_HEIGHT_SHARE = 0.25
_WIDTH_RATIO_MIN = 2.0
_NAME_WIDTH_SHARE = 0.35
_BALL = 0.8  # of the surface's radius: the ball that the mouse turns
_TOP = math.pi / 2  # how far the turntable tilts

Place = tuple[float, float]


@dataclass(frozen=True)
class Slot:
    """What a surface is clipped to, and where its name is, above or beside it."""

    rect: Rect
    name: Rect

    @property
    def middle(self) -> Place:
        left, top, right, bottom = self.rect
        return (left + right) / 2, (top + bottom) / 2

    @property
    def half(self) -> tuple[float, float]:
        """From the middle to the sides, less the margins."""
        left, top, right, bottom = self.rect
        width, height = right - left, bottom - top
        margin = _MARGIN * min(width, height)
        return width / 2 - margin, height / 2 - margin


Slots = Mapping[str, Slot]


def slots(
    names: Sequence[str], rect: Rect, shape: tuple[float, float], layout: Layout, name_height: float
) -> dict[str, Slot]:
    """Divide a rectangle by rows into slots for surfaces of a shape, large if automatic."""
    count = len(names)

    def goodness(columns: int) -> float:
        """Rate how large surfaces are from the front, and a little from any side."""
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
    """Return how much a shape (width, height) can be scaled to fit into half a width and height."""
    return min(2 * room / max(length, 1e-12) for room, length in zip(half, shape, strict=True))


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
    """One look at surfaces in slots, all the same, in parallel projection; places are pixels of the
    window, points those of the surface as it is drawn. What the mouse does gives another view.
    """

    slots: Slots
    rotation: FloatArray  # (3, 3): rows are what is to the right, up, and towards the viewer
    target: FloatArray  # (3,): in the slots' middle
    home: FloatArray  # (3,): where a target is when nothing was moved
    upright: FloatArray  # (3,): the axis that points up from the surface's front
    zoom: float
    scale: float  # pixels of a length of 1
    radius: float  # of the surface, about home
    above: float  # how far it goes up from there, now

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Places and depths (P, 3) of points (P, 3) of a surface; what is nearer has less depth."""
        x, y, z = ((np.atleast_2d(points) - self.target) @ self.rotation.T).T
        middle = self.slots[name].middle
        return np.stack([middle[0] + self.scale * x, middle[1] - self.scale * y, -z], axis=1)

    def matrix(self, name: str, window: tuple[int, int], scale: float) -> FloatArray:
        """Return what (4, 4) puts a surface into its slot, for a viewer along z to whom a length of
        1 has a scale in pixels.
        """
        matrix, share = np.eye(4), self.scale / scale
        matrix[:3, :3], matrix[:3, 3] = self.rotation, -self.rotation @ self.target
        matrix[:3] *= share
        matrix[:2, 3] += share * self.drawn(self.slots[name].middle, window)
        return matrix

    def drawn(self, place: Place, window: tuple[int, int]) -> FloatArray:
        return np.array([place[0] - window[0] / 2, window[1] / 2 - place[1]]) / self.scale

    @property
    def is_clipped(self) -> bool:
        return self.zoom > 1 or bool(np.abs(self.target - self.home).max() > 1e-9 * self.radius)

    @property
    def is_of_document(self) -> bool:
        slot = next(iter(self.slots.values()))
        return slot.name[3] > slot.rect[1] + 1

    def label(self, name: str) -> Rect:
        """Return where a surface's name is written: close above or before it, in its slot."""
        slot, (x, y, _) = self.slots[name], self.projected(name, self.home)[0].tolist()
        left, top, right, bottom = slot.name
        if self.is_of_document:
            return left, top, min(max(x - self.scale * self.radius, right), slot.rect[2]), bottom
        end = min(max(y - self.scale * self.above, bottom), slot.rect[3])
        return left, end - (bottom - top), right, end

    def borders(self) -> list[tuple[Place, Place]]:
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
        """The surface in whose slot a place is, or that is nearest to it."""

        def distance(name: str) -> float:
            left, top, right, bottom = self.slots[name].rect
            beside = max(left - place[0], 0, place[0] - right)
            return math.hypot(beside, max(top - place[1], 0, place[1] - bottom))

        return min(self.slots, key=distance)

    def turned(self, name: str, start: Place, end: Place) -> Self:
        one, other = (self._on_ball(name, place) for place in (start, end))
        axis = np.cross(one, other)
        sine = float(np.linalg.norm(axis))
        if sine < 1e-12:
            return self
        turn = rotation(axis / sine, math.atan2(sine, float(one @ other)))
        return replace(self, rotation=_orthonormal(turn @ self.rotation))

    def orbited(self, delta: Place) -> Self:
        """After the mouse dragged a turntable: sideways it turns, up and down it tilts."""
        radian = _BALL * self.radius * self.scale / self.zoom
        _, up, towards = self.rotation @ self.upright
        before = math.atan2(towards, up)
        after = before + delta[1] / radian
        if abs(before) <= _TOP + 1e-6:  # else it was turned over by hand
            after = min(max(after, -_TOP), _TOP)
        around = rotation(self.rotation @ self.upright, delta[0] / radian)
        tilt = rotation(np.array([1.0, 0.0, 0.0]), after - before)
        return replace(self, rotation=_orthonormal(tilt @ around @ self.rotation))

    def moved(self, delta: Place) -> Self:
        """After the mouse moved the surfaces by pixels, which cannot be lost."""
        shift = np.array([-delta[0], delta[1], 0.0]) / self.scale
        away = self.target + shift @ self.rotation - self.home
        share = min(1.0, self.radius / max(float(np.linalg.norm(away)), 1e-12))
        return replace(self, target=self.home + away * share)

    def zoomed(self, name: str, place: Place, factor: float) -> Self:
        """Come nearer to what is under the mouse; going farther leads back home."""
        zoom = min(max(self.zoom * factor, ZOOM_MIN), ZOOM_MAX)
        if zoom < self.zoom:
            share = max(0.0, 1 - 1 / zoom) / (1 - 1 / self.zoom) if self.zoom > 1 else 1.0
            return replace(self, zoom=zoom, target=self.home + share * (self.target - self.home))
        middle = self.slots[name].middle
        away = np.array([place[0] - middle[0], middle[1] - place[1], 0.0]) / self.scale
        target = self.target + (1 - self.zoom / zoom) * away @ self.rotation
        return replace(self, zoom=zoom, target=target)

    def seen_alike(self, front: Front, fit: Fit, other: Front) -> SlotView:
        """Return the view of another surface, with a fit and a front of its own, that is turned,
        zoomed and moved as this one is from its front.
        """
        axes = self.rotation @ front.axes.T @ other.axes
        seen = fit.view(self.slots, Front(triple(axes[2]), triple(axes[1])), self.zoom, None)
        moved = front.axes @ (self.target - self.home) * (self.scale / seen.scale)
        return replace(seen, target=seen.home + moved @ other.axes)

    def _on_ball(self, name: str, place: Place) -> FloatArray:
        """A unit vector to where a place is on the ball, or on the hyperboloid around it."""
        middle, radius = self.slots[name].middle, _BALL * self.radius * self.scale
        x, y = (place[0] - middle[0]) / radius, (middle[1] - place[1]) / radius
        square = x * x + y * y
        point = np.array([x, y, np.sqrt(1 - square) if square < 0.5 else 0.5 / np.sqrt(square)])
        unit: FloatArray = point / np.linalg.norm(point)
        return unit


def rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Return the matrix (3, 3) of the rotation about a unit axis (3,), by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: FloatArray = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return turn


def _orthonormal(rotation: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) without what rounding has added to it."""
    direction, right = rotation[2], np.cross(rotation[1], rotation[2])
    direction, right = direction / np.linalg.norm(direction), right / np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])


class Fit:
    """How large a surface with these points (P, 3) can be without standing out of a slot."""

    def __init__(self, points: FloatArray, front: Front) -> None:
        axes = front.axes
        low, high = (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)
        self.shape: tuple[float, float] = (float(high[0] - low[0]), float(high[1] - low[1]))
        self._home: FloatArray = (low + high) / 2 @ axes
        self._upright = axes[1]
        self._around = points - self._home
        self._radius = float(np.linalg.norm(self._around, axis=1).max())
        self._seen: tuple[Front, FloatArray, tuple[float, float], float] | None = None

    def view(self, slots: Slots, front: Front, zoom: float, target: FloatArray | None) -> SlotView:
        if self._seen is None or self._seen[0] != front:  # most frames look from where one did
            axes = front.axes
            across, upwards = (self._around @ axes[:2].T).T
            size = 2 * float(np.abs(across).max()), 2 * float(np.abs(upwards).max())
            self._seen = front, axes, size, float(upwards.max())
        _, axes, size, above = self._seen
        half = next(iter(slots.values())).half
        scale = zoom * min(fitting(half, self.shape), fitting(half, size))
        home = self._home
        target = home if target is None else target
        return SlotView(slots, axes, target, home, self._upright, zoom, scale, self._radius, above)

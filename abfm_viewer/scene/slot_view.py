"""How surfaces are seen in their slots, and what turns, moves and zooms them: geometry."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from abfm.types import FloatArray
from abfm_viewer.document.document import FARTHEST, NEAREST, Front
from abfm_viewer.scene.slots import Slot, fitting
from abfm_viewer.widgets.widget_record import Rect

Place = tuple[float, float]
_BALL = 0.8  # of the surface's radius: the ball that the mouse turns
_TOP = math.pi / 2  # how far the turntable tilts


@dataclass(frozen=True, eq=False)
class SlotView:
    """One look at surfaces in slots; places are pixels of the window, and points those of the
    surface as it is drawn.

    All surfaces are the same, in parallel projection, so that they look alike wherever they stand.
    """

    slots: Mapping[str, Slot]
    rotation: FloatArray  # (3, 3): rows are what is to the right, up, and towards the viewer
    target: FloatArray  # (3,): in the slots' middle
    home: FloatArray  # (3,): where a target is when nothing was moved
    upright: FloatArray  # (3,): the axis that points up from the surface's front
    zoom: float
    scale: float  # pixels of a length of 1
    radius: float  # of the surface, about home
    above: float  # how far it goes up from there, now

    def seen(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) from the slot's middle: to the right, up, and towards the viewer."""
        return (points - self.target) @ self.rotation.T

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Places and depths (P, 3) of points (P, 3) of a surface; what is nearer has less depth."""
        x, y, z = self.seen(np.atleast_2d(points)).T
        middle = self.slots[name].middle
        return np.stack([middle[0] + self.scale * x, middle[1] - self.scale * y, -z], axis=1)

    def matrix(self, name: str, window: tuple[int, int]) -> FloatArray:
        """Return what (4, 4) puts a surface into its slot, for a viewer along z."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, -self.rotation @ self.target
        matrix[:2, 3] += self.drawn(self.slots[name].middle, window)
        return matrix

    def drawn(self, place: Place, window: tuple[int, int]) -> FloatArray:
        """Return where (2,) a place of the window is for that viewer."""
        return np.array([place[0] - window[0] / 2, window[1] / 2 - place[1]]) / self.scale

    @property
    def is_clipped(self) -> bool:
        """Return whether surfaces may go beyond their slots."""
        return self.zoom > 1 or bool(np.abs(self.target - self.home).max() > 1e-9 * self.radius)

    @property
    def is_beside(self) -> bool:
        """Return whether names are at the left of their surfaces, instead of above them."""
        slot = next(iter(self.slots.values()))
        return slot.name[3] > slot.rect[1] + 1

    def label(self, name: str) -> Rect:
        """Return where a surface's name is written: close above or before it, in its slot."""
        slot = self.slots[name]
        left, top, right, bottom = slot.name
        if self.is_beside:
            surface = float(self.projected(name, self.home)[0, 0]) - self.scale * self.radius
            return left, top, min(max(surface, right), slot.rect[2]), bottom
        surface = float(self.projected(name, self.home)[0, 1]) - self.scale * self.above
        end = min(max(surface, bottom), slot.rect[3])
        return left, end - (bottom - top), right, end

    def borders(self) -> list[tuple[Place, Place]]:
        """Lines between slots, while what is in them goes to their ends."""
        if not self.is_clipped:
            return []
        rects = [(*slot.name[:2], *slot.rect[2:]) for slot in self.slots.values()]
        edge = min(left for left, *_ in rects), max(right for _, _, right, _ in rects)
        sides = {
            (x, top, bottom)
            for left, top, right, bottom in rects
            for x in (left, right)
            if edge[0] < x < edge[1]
        }
        tops = {top for _, top, _, _ in rects} - {min(top for _, top, _, _ in rects)}
        down = [((x, top), (x, bottom)) for x, top, bottom in sorted(sides)]
        return [*down, *(((edge[0], top), (edge[1], top)) for top in sorted(tops))]

    def slot_at(self, place: Place) -> str:
        """The surface in whose slot a place is, or that is nearest to it."""

        def distance(name: str) -> float:
            left, top, right, bottom = self.slots[name].rect
            beside = max(left - place[0], 0, place[0] - right)
            return math.hypot(beside, max(top - place[1], 0, place[1] - bottom))

        return min(self.slots, key=distance)

    # What the mouse does; targets of looks are in the drawn surface's coordinates

    def turned(self, name: str, start: Place, end: Place) -> FloatArray:
        """Return the rotation after the mouse dragged the ball around a surface."""
        one, other = (self._on_ball(name, place) for place in (start, end))
        axis = np.cross(one, other)
        sine = float(np.linalg.norm(axis))
        if sine < 1e-12:
            return self.rotation
        return _orthonormal(
            _rotation(axis / sine, math.atan2(sine, float(one @ other))) @ self.rotation
        )

    def orbited(self, delta: Place) -> FloatArray:
        """Return the rotation after the mouse dragged a turntable by pixels.

        Sideways it turns about the upright axis; up and down it tilts that axis, at most until
        the surface is seen from above or below.
        """
        radian = _BALL * self.radius * self.scale / self.zoom
        _, up, towards = self.rotation @ self.upright
        before = math.atan2(towards, up)
        after = before + delta[1] / radian
        if abs(before) <= _TOP + 1e-6:  # else it was turned over by hand
            after = min(max(after, -_TOP), _TOP)
        around = _rotation(self.rotation @ self.upright, delta[0] / radian)
        tilt = _rotation(np.array([1.0, 0.0, 0.0]), after - before)
        return _orthonormal(tilt @ around @ self.rotation)

    def moved(self, delta: Place) -> FloatArray:
        """The target after the mouse moved the surfaces by pixels."""
        shift = np.array([-delta[0], delta[1], 0.0]) / self.scale
        target: FloatArray = self.target + shift @ self.rotation
        away = target - self.home
        return self.home + away * min(1.0, self.radius / max(float(np.linalg.norm(away)), 1e-12))

    def zoomed(self, name: str, place: Place, factor: float) -> tuple[float, FloatArray]:
        """The zoom and the target after coming nearer: what is under the mouse stays there.

        Going farther leads back to where the target is home when the surface fits again.
        """
        zoom = min(max(self.zoom * factor, FARTHEST), NEAREST)
        if zoom < self.zoom:
            share = max(0.0, 1 - 1 / zoom) / (1 - 1 / self.zoom) if self.zoom > 1 else 1.0
            return zoom, self.home + share * (self.target - self.home)
        middle = self.slots[name].middle
        away = np.array([place[0] - middle[0], middle[1] - place[1], 0.0]) / self.scale
        return zoom, self.target + (1 - self.zoom / zoom) * away @ self.rotation

    def _on_ball(self, name: str, place: Place) -> FloatArray:
        """A unit vector to where a place is on the ball, or on the hyperboloid around it."""
        middle, radius = self.slots[name].middle, _BALL * self.radius * self.scale
        x, y = (place[0] - middle[0]) / radius, (middle[1] - place[1]) / radius
        square = x * x + y * y
        point = np.array([x, y, np.sqrt(1 - square) if square < 0.5 else 0.5 / np.sqrt(square)])
        unit: FloatArray = point / np.linalg.norm(point)
        return unit


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
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
        low, high = ((points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0))
        self.shape: tuple[float, float] = (float(high[0] - low[0]), float(high[1] - low[1]))
        self.home: FloatArray = (low + high) / 2 @ axes
        self._upright = axes[1]
        self._around = points - self.home
        self.radius = float(np.linalg.norm(self._around, axis=1).max())
        self._turned = front, *self._extent(axes)

    def view(
        self, slots: Mapping[str, Slot], front: Front, zoom: float, target: FloatArray | None
    ) -> SlotView:
        if self._turned[0] != front:  # most frames look from where the one before did
            self._turned = front, *self._extent(front.axes)
        _, axes, size, above = self._turned
        half = next(iter(slots.values())).half
        scale = zoom * min(fitting(half, self.shape), fitting(half, size))
        target = self.home if target is None else target
        return SlotView(
            slots, axes, target, self.home, self._upright, zoom, scale, self.radius, above
        )

    def _extent(self, axes: FloatArray) -> tuple[FloatArray, tuple[float, float], float]:
        """Return axes, the surface's width and height along them, and how far up it goes."""
        across, upwards = (self._around @ axes[:2].T).T
        size = (2 * float(np.abs(across).max()), 2 * float(np.abs(upwards).max()))
        return axes, size, float(upwards.max())

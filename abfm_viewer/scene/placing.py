"""Puts polyscope's structures where a view has them, clipped to their slots."""

from collections.abc import Iterable
from typing import Any

from abfm.types import FloatArray
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.slot_view import SlotView
from abfm_viewer.scene.viewport import face

Placed = tuple[str, str, object, Any]
"""The surface that a structure belongs to, its own name, a version that changes with it, and
polyscope's handle.
"""


class Placing:
    """Gives structures the transform and clipping of their slot; without one they are hidden."""

    def __init__(self) -> None:
        self._clipping = Clipping()
        self._seen: object = None
        self._count = 0
        self._done: dict[str, tuple[object, int]] = {}

    def forget(self) -> None:
        """Do all of it again: surfaces were registered anew."""
        self._done = {}
        self._clipping.forget()

    def place(self, view: SlotView, turned: FloatArray, structures: Iterable[Placed]) -> None:
        """Show structures, turned by a matrix (4, 4) before all else."""
        window = ps.get_window_size()
        arrays = (view.rotation, view.target, turned)
        seen = (window, view.scale, *view.slots.items(), *(array.tobytes() for array in arrays))
        if seen != self._seen:
            self._seen = seen
            self._count += 1
            face(view)
            self._clipping.place(view, window, clips=view.is_clipped)
        for surface, name, version, structure in structures:
            if self._done.get(name) == (version, self._count):
                continue
            self._done[name] = version, self._count
            structure.set_enabled(surface in view.slots)
            if surface in view.slots:
                structure.set_transform(view.matrix(surface, window) @ turned)
                self._clipping.apply(structure, name, version, view, surface)


_Side = tuple[int, float, int]  # across x or y (0, 1), at pixels, and which side of it is kept


class Clipping:
    """One plane for each side that slots have; every structure minds those of its slot.

    There are none until something is clipped: each costs time in every pixel.
    """

    def __init__(self) -> None:
        # names: a handle that outlives its plane spoils later ones at its address
        self._planes: list[str] = []
        self._sides: list[_Side] = []
        self._active = False
        self._minded: dict[str, tuple[object, tuple[_Side, ...]]] = {}

    def place(self, view: SlotView, window: tuple[int, int], clips: bool) -> None:
        """Put the planes where the slots' sides are."""
        all_sides = [side for name in view.slots for side in _sides(view, name)]
        sides = [*dict.fromkeys(all_sides)] if clips else []
        if clips and sides != self._sides:
            self._sides = sides
            self._minded = {}
        while len(self._planes) < len(sides):
            plane = ps.add_slice_plane()
            plane.set_draw_plane(False)
            plane.set_draw_widget(False)
            self._planes.append(plane.get_name())
        for number, name in enumerate(self._planes):
            plane = ps.get_slice_plane(name)
            if plane.get_active() != (number < len(sides)):
                plane.set_active(number < len(sides))
        for name, (axis, at, sign) in zip(self._planes, sides, strict=False):
            position, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            position[axis] = float(view.drawn((at, at), window)[axis])
            normal[axis] = float(sign)
            ps.get_slice_plane(name).set_pose(position, normal)
        self._active = clips

    def forget(self) -> None:
        """Tell all structures again: they were registered anew."""
        self._minded = {}

    def apply(
        self, structure: Any, key: str, version: object, view: SlotView, surface: str
    ) -> None:
        """Let a structure mind the planes of a surface's slot; a `version` of it is told once."""
        if not self._active:
            return
        kept = _sides(view, surface)
        if self._minded.get(key) == (version, kept):
            return
        self._minded[key] = version, kept
        for name, side in zip(self._planes, self._sides, strict=False):
            ignored = side not in kept
            if structure.get_ignore_slice_plane(name) != ignored:
                structure.set_ignore_slice_plane(name, ignored)


def _sides(view: SlotView, name: str) -> tuple[_Side, ...]:
    left, top, right, bottom = view.slots[name].rect
    return (0, left, 1), (0, right, -1), (1, top, -1), (1, bottom, 1)

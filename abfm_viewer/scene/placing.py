"""Puts polyscope's structures where a view has them, with as little work as what changed allows."""

from collections.abc import Iterable
from typing import Any

from abfm.types import FloatArray
from abfm_viewer.scene.clipping import Clipping
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.slot_view import SlotView
from abfm_viewer.scene.viewport import Viewport

Placed = tuple[str, str, object, Any]
"""The surface that a structure belongs to, its own name, a version that changes with it, and polyscope's handle."""


class Placing:
    """Gives structures the transform and the clipping of their surface, and hides those of surfaces without a slot."""

    def __init__(self) -> None:
        self._clipping = Clipping()
        self._seen: object = None
        self._count = 0
        self._done: dict[str, tuple[object, int]] = {}

    def forget(self) -> None:
        """Do all of it again: surfaces were registered anew."""
        self._done = {}
        self._clipping.forget()

    def place(self, viewport: Viewport, view: SlotView, turned: FloatArray, structures: Iterable[Placed]) -> None:
        """Show structures, turned by a matrix (4, 4) before all else."""
        window = ps.get_window_size()
        arrays = (view.rotation, view.target, turned)
        seen = (window, view.scale, tuple(view.slots.items()), *(array.tobytes() for array in arrays))
        if seen != self._seen:
            self._seen = seen
            self._count += 1
            viewport.face(view)
            self._clipping.place(view, window, clips=view.is_clipped)
        for surface, name, version, structure in structures:
            if self._done.get(name) == (version, self._count):
                continue
            self._done[name] = version, self._count
            structure.set_enabled(surface in view.slots)
            if surface in view.slots:
                structure.set_transform(view.matrix(surface, window) @ turned)
                self._clipping.apply(structure, name, version, view, surface)

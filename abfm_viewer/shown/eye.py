"""Points of view, and the parts of a surface that are hidden from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import abfm
from abfm.types import BoolArray, FloatArray, IntArray

_PIXELS = 1024  # along the longer side of a depth map


@dataclass(frozen=True, eq=False)
class Eye:
    """A point of view, in units of the square root of a surface's area."""

    axes: FloatArray  # (3, 3): its rows point right, up, and towards the viewer
    place: FloatArray | None = None  # (3,) of a perspective; None for a parallel projection

    def towards(self, places: FloatArray) -> FloatArray:
        """Return unit vectors from places (..., 3) towards the eye."""
        if self.place is None:
            return np.asarray(np.broadcast_to(self.axes[2], places.shape))
        away = self.place - places
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def projected(self, places: FloatArray) -> FloatArray:
        """Return the positions of places (P, 3) in the picture, and their depths, (P, 3).

        The depth is linear in the picture and larger for nearer places.
        """
        if self.place is None:
            return np.asarray(places @ self.axes.T)
        right, up, near = ((places - self.place) @ self.axes.T).T
        return np.asarray(np.stack([right, up, np.ones(len(places))], axis=1) / -near[:, None])

    def before(self, nearest: FloatArray, depths: FloatArray) -> FloatArray:
        """Return the distances, along the line of sight, from depths (P,) to nearer ones (P,)."""
        return np.asarray(nearest - depths if self.place is None else 1 / depths - 1 / nearest)

    def hides(
        self,
        surface: tuple[FloatArray, IntArray],
        places: FloatArray,
        cosines: FloatArray,
        slack: float,
    ) -> BoolArray:
        """Return which places (P, 3) are hidden by a surface, (P,).

        ``surface`` is a pair of vertices (V, 3) and faces. It hides a place if it is more than
        ``slack`` in front of it. ``cosines`` (P,), positive, are those between the normal of the
        surface at the places and the line of sight.
        """
        vertices, faces = surface
        seen = self.projected(vertices)
        low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
        pixel = float((high - low).max()) / _PIXELS
        width, height = (int(n) for n in np.ceil((high - low) / pixel + 1e-9))
        seen[:, :2] = (seen[:, :2] - low) / pixel
        nearest = abfm.maps.nearest_depths(seen, faces, max(width, 1), max(height, 1))
        projected = self.projected(places)
        column, row = ((projected[:, :2] - low) / pixel).astype(np.int64).T
        found = nearest[row.clip(0, len(nearest) - 1), column.clip(0, len(nearest[0]) - 1)]
        is_there, hidden = found > -np.inf, np.zeros(len(places), dtype=bool)
        # on a slope, the middle of a pixel may be nearer than a place in the same pixel
        depths = projected[is_there, 2]
        length = pixel if self.place is None else pixel / depths
        slope = np.sqrt(1 / cosines[is_there] ** 2 - 1)
        hidden[is_there] = self.before(found[is_there], depths) > slack + length * slope
        return hidden

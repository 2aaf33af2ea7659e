"""Where a surface is seen from, and what of it is hidden by its other parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import abfm
from abfm.types import BoolArray, FloatArray, IntArray

_PIXELS = 1024  # of a map of depths, along its longer side


@dataclass(frozen=True, eq=False)
class Eye:
    """An eye that sees surfaces in parallel projection, or in perspective from a place (3,), in
    units of the square root of a surface's area; axes (3, 3) are what is right, up, and towards it.
    """

    axes: FloatArray
    place: FloatArray | None = None

    def towards(self, places: FloatArray) -> FloatArray:
        """Return unit vectors from places (..., 3) towards the eye."""
        if self.place is None:
            return np.asarray(np.broadcast_to(self.axes[2], places.shape))
        away = self.place - places
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def projected(self, places: FloatArray) -> FloatArray:
        """Return where places (P, 3) are in the picture, and what is linear in it and larger where
        they are nearer, (P, 3).
        """
        if self.place is None:
            return np.asarray(places @ self.axes.T)
        right, up, near = ((places - self.place) @ self.axes.T).T
        return np.asarray(np.stack([right, up, np.ones(len(places))], axis=1) / -near[:, None])

    def before(self, nearest: FloatArray, own: FloatArray) -> FloatArray:
        """Return how far the nearest of what is seen (P,) is before places' own (P,)."""
        return np.asarray(nearest - own if self.place is None else 1 / own - 1 / nearest)

    def hides(
        self,
        surface: tuple[FloatArray, IntArray],
        places: FloatArray,
        cosines: FloatArray,
        slack: float,
    ) -> BoolArray:
        """Tell which of the places (P, 3) a surface, by vertices (V, 3) and faces, has before them,
        farther than the slack, (P,); it is seen there at angles of these cosines (P,), more than 0.
        """
        vertices, faces = surface
        seen = self.projected(vertices)
        low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
        pixel = float((high - low).max()) / _PIXELS
        width, height = (int(n) for n in np.ceil((high - low) / pixel + 1e-9))
        seen[:, :2] = (seen[:, :2] - low) / pixel
        nearest = abfm.maps.nearest_depths(seen, faces, max(width, 1), max(height, 1))
        own = self.projected(places)
        column, row = ((own[:, :2] - low) / pixel).astype(np.int64).T
        found = nearest[row.clip(0, len(nearest) - 1), column.clip(0, len(nearest[0]) - 1)]
        is_there, hidden = found > -np.inf, np.zeros(len(places), dtype=bool)
        # a pixel's middle may be nearer than a place beside it on the same slope
        length = pixel if self.place is None else pixel / own[is_there, 2]
        slope = np.sqrt(1 / cosines[is_there] ** 2 - 1)
        hidden[is_there] = self.before(found[is_there], own[is_there, 2]) > slack + length * slope
        return hidden

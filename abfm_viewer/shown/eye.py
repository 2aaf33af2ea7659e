"""Where a surface is seen from, and what of it is hidden by its other parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import BoolArray, FloatArray, IntArray

_PIXELS = 1024  # of a map of depths, along its longer side
_NEARER = 0.008  # of sqrt(area): what is less far before a place lies on it


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
    ) -> BoolArray:
        """Tell which of the places (P, 3) a surface, by vertices (V, 3) and faces, has before them,
        (P,); the surface is seen there at angles of these cosines (P,), more than 0.
        """
        vertices, faces = surface
        seen = self.projected(vertices)
        low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
        pixel = float((high - low).max()) / _PIXELS
        width, height = (int(n) for n in np.ceil((high - low) / pixel + 1e-9))
        nearest = np.full((max(height, 1), max(width, 1)), -np.inf)
        seen[:, :2] = (seen[:, :2] - low) / pixel
        draw_nearest(seen, faces, nearest)
        own = self.projected(places)
        column, row = ((own[:, :2] - low) / pixel).astype(np.int64).T
        found = nearest[row.clip(0, len(nearest) - 1), column.clip(0, len(nearest[0]) - 1)]
        is_there, hidden = found > -np.inf, np.zeros(len(places), dtype=bool)
        # a pixel's middle may be nearer than a place beside it on the same slope
        length = pixel if self.place is None else pixel / own[is_there, 2]
        slope = np.sqrt(1 / cosines[is_there] ** 2 - 1)
        hidden[is_there] = self.before(found[is_there], own[is_there, 2]) > _NEARER + length * slope
        return hidden


@kernel
def draw_nearest(seen: FloatArray, faces: IntArray, nearest: FloatArray) -> None:
    """Draw faces (F, 3) of vertices (V, 3), in pixels, into what is nearest at pixels' middles."""
    height, width = nearest.shape
    for f in range(len(faces)):
        a, b, c = seen[faces[f, 0]], seen[faces[f, 1]], seen[faces[f, 2]]
        double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if double == 0.0:
            continue
        left = max(int(np.ceil(min(a[0], b[0], c[0]) - 0.5)), 0)
        right = min(int(np.floor(max(a[0], b[0], c[0]) - 0.5)), width - 1)
        low = max(int(np.ceil(min(a[1], b[1], c[1]) - 0.5)), 0)
        high = min(int(np.floor(max(a[1], b[1], c[1]) - 0.5)), height - 1)
        for row in range(low, high + 1):
            for column in range(left, right + 1):
                x, y = column + 0.5, row + 0.5
                of_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / double
                of_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / double
                if of_b >= 0.0 and of_c >= 0.0 and of_b + of_c <= 1.0:
                    near = a[2] + of_b * (b[2] - a[2]) + of_c * (c[2] - a[2])
                    nearest[row, column] = max(nearest[row, column], near)

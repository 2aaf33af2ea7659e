"""Viewpoints, and the parts of a surface that are hidden from them."""

from dataclasses import dataclass

import numpy as np

import abfm
from abfm.types import BoolArray, FloatArray, IntArray

_PIXELS = 1024  # along the longer side of a depth map


@dataclass(frozen=True, eq=False)
class Eye:
    """A viewpoint: position and axes of the viewer, in units of sqrt(area) of the surface."""

    axes: FloatArray  # (3, 3): its rows point right, up, and towards the viewer
    place: FloatArray | None = None  # (3,), position in perspective; None for a parallel projection

    def towards(self, places: FloatArray) -> FloatArray:
        """Return unit vectors from points (..., 3) towards the viewer."""
        if self.place is None:
            return np.asarray(np.broadcast_to(self.axes[2], places.shape))
        away = self.place - places
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def projected(self, places: FloatArray) -> FloatArray:
        """Return the two picture coordinates of points (P, 3), and their depths, as (P, 3).

        The depth varies linearly over the picture of a plane, and is larger for nearer points.
        """
        if self.place is None:
            return np.asarray(places @ self.axes.T)
        right, up, near = ((places - self.place) @ self.axes.T).T
        return np.asarray(np.stack([right, up, np.ones(len(places))], axis=1) / -near[:, None])

    def before(self, nearest: FloatArray, depths: FloatArray) -> FloatArray:
        """Return distances (P,), along the line of sight, between points of two depths (P,).

        ``nearest`` are the depths of points in front, and ``depths`` those of points behind them.
        """
        return np.asarray(nearest - depths if self.place is None else 1 / depths - 1 / nearest)

    def hides(
        self,
        surface: tuple[FloatArray, IntArray],
        places: FloatArray,
        cosines: FloatArray,
        slack: float,
    ) -> BoolArray:
        """Return a mask (P,) of the points ``places`` (P, 3) that a surface hides from the viewer.

        ``surface`` is a pair of vertices (V, 3) and faces (F, 3). It hides a point if it lies more
        than ``slack`` in front of the point. ``cosines`` (P,), all positive, are those of the
        angles between the surface's normal at the points and the line of sight.
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

"""Motion of a sequence for drawing: the speed of the longest arrows, and critical points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import abfm
import abfm.maps
import abfm.sequences
from abfm.types import FloatArray

OPACITY_MIN = 0.1
"""Minimum opacity of arrows. The opacity is how well the frames determine the field, 0 to 1."""
CRITICAL_COLORS = {
    "source": (0.949, 0.722, 0.020, 1.0),
    "sink": (0.110, 0.486, 0.235, 1.0),
    "spiral": (0.541, 0.247, 1.000, 1.0),
    "saddle": (0.851, 0.102, 0.569, 1.0),
}
"""Colours of critical points by kind, sRGB with alpha; they differ from those of functions."""
_PIECE_LENGTH = 0.01  # sqrt(area): longer pieces of a path could cut through the surface


def fast_speed_of(sequence: abfm.Sequence) -> float:
    """Return the speed from which arrows of a sequence have their maximum length.

    It is the root mean square of `abfm.calculus.fast_speed` over intervals. One fast interval
    therefore does not shorten the arrows of all others.
    """
    speeds = (np.linalg.norm(field, axis=1) for field in sequence.velocity)
    fast = [abfm.calculus.fast_speed(sequence.mesh, speed) for speed in speeds]
    return float(np.linalg.norm(fast) / np.sqrt(len(fast)))


@dataclass(frozen=True, eq=False)
class PointPath:
    """Path of a critical point: its kind, and dense points at times (K,)."""

    kind: str
    times: FloatArray
    points: abfm.maps.SurfacePoints

    def at(self, time: float, slack: float) -> FloatArray | None:
        """Return the position (3,) at a time, up to ``slack`` before or after the path, or None."""
        if not self.times[0] - slack <= time <= self.times[-1] + slack:
            return None
        places = self.points.positions
        return np.array([np.interp(time, self.times, places[:, axis]) for axis in range(3)])


def track_paths(tracks: Sequence[abfm.sequences.Track]) -> list[PointPath]:
    """Return the paths of tracks, with additional points on the surface between critical points."""
    if not tracks:
        return []
    mesh, positions, times = tracks[0].points.mesh, [], []
    for track in tracks:
        places = track.points.positions
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        pieces_of_steps = np.ceil(steps / (_PIECE_LENGTH * mesh.length_scale))
        counts = np.maximum(pieces_of_steps, 1).astype(int)
        pieces = [k + np.arange(count) / count for k, count in enumerate(counts.tolist())]
        positions_in_track = np.concatenate([*pieces, [len(places) - 1.0]])
        rows = np.arange(float(len(places)))
        columns = [np.interp(positions_in_track, rows, places[:, axis]) for axis in range(3)]
        positions.append(np.stack(columns, axis=1))
        times.append(np.interp(positions_in_track, rows, track.times))
    points = abfm.maps.project_onto_surface(mesh, np.concatenate(positions))
    ends = np.cumsum([len(each) for each in positions])
    return [
        PointPath(track.kind, each, points[np.arange(end - len(each), end)])
        for track, each, end in zip(tracks, times, ends, strict=True)
    ]

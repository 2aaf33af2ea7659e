"""Motion of a sequence as it is drawn: fast fields, and paths of critical points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import abfm
import abfm.maps
import abfm.sequences
from abfm.types import FloatArray

OPACITY_MIN = 0.1
"""Smallest opacity of arrows, which is how well frames determine the field there, 0 to 1."""
CRITICAL_COLORS = {
    "source": (0.949, 0.722, 0.020, 1.0),
    "sink": (0.110, 0.486, 0.235, 1.0),
    "spiral": (0.541, 0.247, 1.000, 1.0),
    "saddle": (0.851, 0.102, 0.569, 1.0),
}
"""Colours of critical points by kind, sRGB with alpha, unlike the colours of functions."""
_PIECE = 0.01  # of sqrt(area): between points of a way, which else would cut through the surface


def fast_in(sequence: abfm.Sequence) -> float:
    """What counts as fast in a film: the root mean square over its intervals of what does in each,
    so that no single one makes arrows of all others short.
    """
    speeds = (np.linalg.norm(field, axis=1) for field in sequence.velocity)
    fast = [abfm.calculus.fast_speed(sequence.mesh, speed) for speed in speeds]
    return float(np.linalg.norm(fast) / np.sqrt(len(fast)))


@dataclass(frozen=True, eq=False)
class PointPath:
    """A critical point's places at times (K,), close enough to be joined, and what it mostly is."""

    kind: str
    times: FloatArray
    points: abfm.maps.SurfacePoints

    def at(self, time: float, slack: float) -> FloatArray | None:
        """Return where it is at a time (3,); None before it comes and after it has gone, but for
        half an interval.
        """
        if not self.times[0] - slack <= time <= self.times[-1] + slack:
            return None
        places = self.points.positions
        return np.array([np.interp(time, self.times, places[:, axis]) for axis in range(3)])


def ways_of(tracks: Sequence[abfm.sequences.Track]) -> list[PointPath]:
    """Return the ways of tracks, between their points on the surface."""
    if not tracks:
        return []
    mesh, between, times = tracks[0].points.mesh, [], []
    for track in tracks:
        places = track.points.positions
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / (_PIECE * mesh.length_scale)
        counts = np.maximum(np.ceil(steps), 1).astype(int)
        along = np.concatenate(
            [k + np.arange(count) / count for k, count in enumerate(counts.tolist())]
            + [np.array([len(places) - 1.0])]
        )
        rows = np.arange(float(len(places)))
        columns = [np.interp(along, rows, places[:, axis]) for axis in range(3)]
        between.append(np.stack(columns, axis=1))
        times.append(np.interp(along, rows, track.times))
    points = abfm.maps.project_onto_surface(mesh, np.concatenate(between))
    ends = np.cumsum([len(each) for each in between])
    return [
        PointPath(track.kind, each, points[np.arange(end - len(each), end)])
        for track, each, end in zip(tracks, times, ends, strict=True)
    ]

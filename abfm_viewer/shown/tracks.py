"""Ways of a film's critical points over the surface, found off the frame loop."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import abfm
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.session import Session

if TYPE_CHECKING:
    from abfm import Sequence
    from abfm.maps import SurfacePoints
    from abfm.sequences import Episode, Track

KINDS = ("source", "sink", "spiral", "saddle")
_PIECE = 0.01  # of sqrt(area): between points of a way, which else would cut through the surface


@dataclass(frozen=True, eq=False)
class Way:
    """A critical point's places at times (K,), close enough to be joined, and what it mostly is."""

    kind: str
    times: FloatArray
    points: SurfacePoints

    def at(self, time: float, slack: float) -> FloatArray | None:
        """Return where it is at a time (3,); None before it comes and after it has gone, but for
        half an interval.
        """
        if not self.times[0] - slack <= time <= self.times[-1] + slack:
            return None
        places = self.points.positions
        return np.array([np.interp(time, self.times, places[:, axis]) for axis in range(3)])


def way_of(track: Track) -> Way:
    """Return the way of a track, between its points on the surface."""
    places, mesh = track.points.positions, track.points.mesh
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / (_PIECE * mesh.length_scale)
    counts = np.maximum(np.ceil(steps), 1).astype(int)
    along = np.concatenate(
        [k + np.arange(count) / count for k, count in enumerate(counts.tolist())]
        + [np.array([len(places) - 1.0])]
    )
    rows = np.arange(float(len(places)))
    between = np.stack([np.interp(along, rows, places[:, axis]) for axis in range(3)], axis=1)
    points = abfm.maps.project_onto_surface(mesh, between)
    return Way(track.kind, np.interp(along, rows, track.times), points)


def _ways(sequence: Sequence) -> tuple[Way, ...]:
    return tuple(map(way_of, sequence.tracks()))


class ShownTracks(Jobs):
    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._found: Latest[tuple[Way, ...]] = self.latest()
        self._episodes: Latest[list[Episode]] = self.latest()

    def ways(self) -> tuple[Way, ...]:
        """Return those of the film's result that are wanted and known by now."""
        document = self._session.document
        sequence = document.sequence
        if sequence is None or not document.view.tracks:
            return ()
        return self._found.ask(sequence, lambda: _ways(sequence)) or ()

    def counts(self) -> dict[str, int]:
        """Return how many there are by kind, of kinds that there are."""
        found = Counter(way.kind for way in self.ways())
        return {kind: found[kind] for kind in KINDS if found[kind]}

    def episodes(self) -> list[Episode]:
        """Return when the film's result is slow or fast, as far as it is known by now."""
        sequence = self._session.document.sequence
        return [] if sequence is None else self._episodes.ask(sequence, sequence.episodes) or []

    def now(self) -> dict[str, FloatArray]:
        """Return where they are at the shown time, (P, 3) by kind."""
        document, places = self._session.document, dict[str, list[FloatArray]]()
        if document.film is None:
            return {}
        for way in self.ways():
            if (place := way.at(document.time, self._session.tau / 2)) is not None:
                places.setdefault(way.kind, []).append(place)
        return {kind: np.array(found) for kind, found in places.items()}

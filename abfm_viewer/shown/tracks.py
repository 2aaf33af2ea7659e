"""Tracks of the critical points of a sequence's fields, computed in the background.

A track follows a source, sink, spiral or saddle of the field through the intervals.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

import abfm
from abfm.pages.sequence_motion import PointPath, track_paths
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.session import Session

KINDS = ("source", "sink", "spiral", "saddle")


class ShownTracks(Jobs):
    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._paths: Latest[tuple[PointPath, ...]] = self.latest()
        self._episodes: Latest[list[abfm.sequences.Episode]] = self.latest()

    def paths(self) -> tuple[PointPath, ...]:
        """Return the tracks of the result; empty if they are hidden or still computed."""
        document = self._session.document
        sequence = document.sequence_result
        if sequence is None or not document.view.tracks:
            return ()
        return self._paths.request(sequence, lambda: tuple(track_paths(sequence.tracks()))) or ()

    def counts(self) -> dict[str, int]:
        """Return the number of tracks of each kind; kinds without tracks are omitted."""
        found = Counter(path.kind for path in self.paths())
        return {kind: found[kind] for kind in KINDS if found[kind]}

    def episodes(self) -> list[abfm.sequences.Episode]:
        """Return the slow and fast episodes of the result; empty while they are computed."""
        sequence = self._session.document.sequence_result
        return [] if sequence is None else self._episodes.request(sequence, sequence.episodes) or []

    def now(self) -> dict[str, FloatArray]:
        """Return the positions (P, 3) of the critical points at the shown time, by kind."""
        document, places = self._session.document, dict[str, list[FloatArray]]()
        for path in self.paths():
            if (place := path.at(document.time, self._session.document.tau / 2)) is not None:
                places.setdefault(path.kind, []).append(place)
        return {kind: np.array(found) for kind, found in places.items()}

"""Ways of a film's critical points over the surface, found off the frame loop."""

from __future__ import annotations

from collections import Counter

import numpy as np

import abfm
from abfm.pages.film_motion import PointPath, ways_of
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.session import Session

KINDS = ("source", "sink", "spiral", "saddle")


class ShownTracks(Jobs):
    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._found: Latest[tuple[PointPath, ...]] = self.latest()
        self._episodes: Latest[list[abfm.sequences.Episode]] = self.latest()

    def ways(self) -> tuple[PointPath, ...]:
        """Return those of the film's result that are wanted and known by now."""
        document = self._session.document
        sequence = document.sequence_result
        if sequence is None or not document.view.tracks:
            return ()
        return self._found.ask(sequence, lambda: tuple(ways_of(sequence.tracks()))) or ()

    def counts(self) -> dict[str, int]:
        """Return how many there are by kind, of kinds that there are."""
        found = Counter(way.kind for way in self.ways())
        return {kind: found[kind] for kind in KINDS if found[kind]}

    def episodes(self) -> list[abfm.sequences.Episode]:
        """Return when the film's result is slow or fast, as far as it is known by now."""
        sequence = self._session.document.sequence_result
        return [] if sequence is None else self._episodes.ask(sequence, sequence.episodes) or []

    def now(self) -> dict[str, FloatArray]:
        """Return where they are at the shown time, (P, 3) by kind."""
        document, places = self._session.document, dict[str, list[FloatArray]]()
        for way in self.ways():
            if (place := way.at(document.time, self._session.document.tau / 2)) is not None:
                places.setdefault(way.kind, []).append(place)
        return {kind: np.array(found) for kind, found in places.items()}

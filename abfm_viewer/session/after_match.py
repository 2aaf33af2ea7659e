"""What a match shows of itself when it has ended: its flow, by streaks or arrows, played once."""

from __future__ import annotations

from dataclasses import replace

import abfm
from abfm_viewer.document.document import Document, Identity, View

_MOST_FACES = 50_000  # of a mesh that gets streaks: within two seconds


class AfterMatch:
    """Chooses how the flow is shown.

    Streaks where there is time for them: on meshes of up to 50,000 faces, where the machine draws
    surfaces quickly, as the window says. Arrows everywhere else. The flow is left as the user has
    it if it is shown already, or is shown as something else than the function; and where the user
    hid it after an earlier match of this document, it stays hidden.
    """

    def __init__(self) -> None:
        self.draws_quickly = False
        self._seen: Identity | None = None

    def forget(self) -> None:
        """Show the flow again after the next match, though the user hid it."""
        self._seen = None

    def view(self, document: Document, match: abfm.Match) -> View | None:
        """The view of a document after a match; None where there is nothing to play."""
        view = document.view
        if not view.flow_after_match or not match.velocity.any():
            return None
        known, self._seen = self._seen is document.identity, document.identity
        if known or view.arrows or view.streaks or view.coloring != "function":
            return view
        streaks = self.draws_quickly and len(match.mesh.faces) <= _MOST_FACES
        return replace(view, streaks=streaks, arrows=not streaks)

"""All data that are computed for the pictures of a session, in the background."""

from abfm.pages.colormaps import ColorRange
from abfm_viewer.document.document import Document
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.session.session import Session
from abfm_viewer.shown.landmarks import ShownLandmarks
from abfm_viewer.shown.quantities import FieldQuantities, MassTransport
from abfm_viewer.shown.sequence_flow import SequenceFlow, SequenceQuantities
from abfm_viewer.shown.shown_flow import ShownFlow
from abfm_viewer.shown.tracks import ShownTracks


class Shown:
    """Flow, quantities, landmarks, tracks and transport for the pictures of a session."""

    def __init__(self, session: Session) -> None:
        self.session = session
        match, sequence = ShownFlow(session), SequenceFlow(session)
        self._of_match = FieldQuantities(session, match)
        self._of_kind: dict[type[Document], FieldQuantities] = {
            SequenceDocument: SequenceQuantities(session, sequence)
        }
        self.landmarks = ShownLandmarks(session, match)
        self.tracks = ShownTracks(session)
        self.mass_transport = MassTransport(session)
        # latest ranges of the colours: of "function", "field", "error", "compared" and "on A"
        self.ranges: dict[str, ColorRange] = {}

    @property
    def quantities(self) -> FieldQuantities:
        return self._of_kind.get(type(self.session.document), self._of_match)

    @property
    def flow(self) -> ShownFlow:
        return self.quantities.flow

    @property
    def is_ready(self) -> bool:
        """Whether the flow can be shown at all times, with its streaks if it is not a sequence."""
        waits = self.session.document.has_one_field and self.quantities.convolving
        return self.flow.is_ready and not waits

    @property
    def is_behind(self) -> bool:
        """Whether the pictures do not yet show the result or step that the panel describes."""
        session = self.session
        if session.solver.running or session.result is None or session.outdated:
            return False
        waits = session.player.playing and session.player.waiting
        of_earlier = self.flow.is_behind or self.quantities.is_behind
        return session.steps.busy != "" or waits or of_earlier

    @property
    def busy(self) -> str:
        """Description of the background computation in progress, except a run; or an empty text."""
        if self.session.busy:
            return self.session.busy
        if self.flow.busy:
            return "computing the function at all times"
        if self.quantities.is_computing_field:
            return "computing the field"
        if self.tracks.busy:
            return "following critical points"
        if self.quantities.convolving:
            return "computing streaks"
        return "placing arrows" if self.quantities.is_placing_arrows else ""

    def close(self) -> None:
        for quantities in (self._of_match, *self._of_kind.values()):
            quantities.close()
            quantities.flow.close()
        for one in (self.landmarks, self.tracks, self.mass_transport):
            one.close()

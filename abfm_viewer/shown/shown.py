"""What pictures show of a session: everything that is computed from it."""

import abfm
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.session.session import Session
from abfm_viewer.shown.field_quantities import FieldQuantities
from abfm_viewer.shown.shown_flow import ShownFlow


class MassTransport(Jobs):
    """Optimal transport between source and target at the shown time, at most tau."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._values: Latest[FloatArray] = self.latest()
        self._note = Memo[str]()

    @property
    def note(self) -> str:
        """Say what transport leaves out of the functions; nothing if nothing."""
        source, target = self._session.values("source"), self._session.values("target")
        if source is None or target is None or self.error:
            return ""

        def make() -> str:
            least = min(float(source.min()), float(target.min()))
            text = f"optimal transport takes values below 0, down to {least:.3g}, as 0"
            return text if least < 0 else ""

        return self._note.get((source, target), make)

    def values(self) -> FloatArray | None:
        """The interpolation (V,); None before there is any, or where there cannot be."""
        session = self._session
        source, target = session.values("source"), session.values("target")
        if source is None or target is None:
            return None
        problem = (session.surface().mesh, source, target)
        share = min(session.time / session.parameters.tau, 1.0)
        return self._values.newest(
            problem, share, lambda: abfm.baselines.optimal_transport(*problem, share, sharpen=True)
        )


class Shown:
    def __init__(self, session: Session) -> None:
        self.session = session
        self.flow = ShownFlow(session)
        self.quantities = FieldQuantities(session, self.flow)
        self.mass_transport = MassTransport(session)

    @property
    def is_ready(self) -> bool:
        """Return whether the flow can be played: the player waits for what it would show."""
        return self.flow.is_ready and not self.quantities.convolving

    @property
    def busy(self) -> str:
        """Say in a word or two what is computed in the background besides the solver."""
        if self.session.busy:
            return self.session.busy
        if self.flow.busy:
            return "computing times"
        if self.quantities.finding:
            return "computing the field"
        return "computing streaks" if self.quantities.convolving else ""

    def close(self) -> None:
        for jobs in (self.quantities, self.mass_transport, self.flow):
            jobs.close()

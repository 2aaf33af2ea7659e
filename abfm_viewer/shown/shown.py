"""What pictures show of a session: everything that is computed from it, and nothing that it knows of."""

from abfm_viewer.session.session import Session
from abfm_viewer.shown.field_quantities import FieldQuantities
from abfm_viewer.shown.mass_transport import MassTransport
from abfm_viewer.shown.shown_flow import ShownFlow


class Shown:
    """Looks at a session, for windows and pictures: the flow, what is told of it, and what transport makes instead."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.flow = ShownFlow(session)
        self.quantities = FieldQuantities(session, self.flow)
        self.mass_transport = MassTransport(session)

    @property
    def busy(self) -> str:
        """What is computed in the background besides the solver, in a word or two; empty if nothing."""
        if self.session.busy:
            return self.session.busy
        if self.flow.busy:
            return "computing times"
        if self.quantities.finding:
            return "computing the field"
        return "computing streaks" if self.quantities.convolving else ""

    def close(self) -> None:
        """End all threads."""
        for jobs in (self.quantities, self.mass_transport, self.flow):
            jobs.close()

"""The solver: the one obvious button, what goes on, and what its end means."""

from __future__ import annotations

from abfm_viewer.session import Session
from abfm_viewer.ui import Ui


def draw(ui: Ui, session: Session) -> None:
    """Draw the buttons and the state."""
    solver = session.solver
    if not solver.running:
        tip = "Find the field whose flow carries the source to the target (Ctrl+Enter)."
        if ui.button("Match", tip, primary=True, enabled=bool(session.channels), width=-1):
            session.match()
    else:
        if ui.button("Resume" if solver.paused else "Pause", "Hold the solver, or let it go on.", width=ui.px(120)):
            solver.resume() if solver.paused else solver.pause()
        ui.beside()
        if ui.button("Cancel", "End the run and keep the best field so far.", width=-1):
            solver.cancel()

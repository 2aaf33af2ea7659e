"""What goes on while the solver runs: how far it is, and where in its course."""

import polyscope.imgui as imgui

from abfm_viewer.document.verdict_words import place
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui


def draw(ui: Ui, session: Session) -> None:
    snapshot = session.solver.snapshot
    if snapshot is None:
        imgui.ProgressBar(0, (-1, 0), "")
        ui.note("Starting: making coarser meshes and factoring the norm of the field")
        return
    now, limit = snapshot.iteration, snapshot.problem.parameters.iterations
    imgui.ProgressBar(now.iteration / max(limit, 1), (-1, 0), "")
    ui.note(f"Iteration {now.iteration}/{limit}, mismatch {now.mismatch:.3g}", "ink")
    ui.note(place(now).capitalize())
    if now.warning:
        ui.note(f"{now.warning[:1].upper()}{now.warning[1:]}.", "failure")

"""What goes on while the solver runs: how far it is, where, and how long it may take."""

import polyscope.imgui as imgui

from abfm.workers.progress import Step, rounded
from abfm_viewer.document.verdict_words import capital, place, sentence
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui

_BAR = 8  # high, as those in the viewport: below it is room for three lines and a warning


def draw(ui: Ui, session: Session) -> None:
    solver = session.solver
    snapshot, step = solver.snapshot, solver.step
    if snapshot is None:
        draw_step(ui, step or Step("starting the solver"))
        return
    now, limit = snapshot.iteration, snapshot.problem.parameters.iterations
    imgui.ProgressBar(now.iteration / max(limit, 1), (-1, ui.px(_BAR)), "")
    each = None if step else solver.seconds_each
    left = limit - now.iteration
    at_most = f", at most {rounded(each * left)} more" if each and left > 0 else ""
    ui.note(f"Iteration {now.iteration}/{limit}, mismatch {now.mismatch:.3g}", "ink")
    ui.note(capital(step.words() if step else f"{place(now)}{at_most}"))
    if now.warning:
        ui.note(sentence(now.warning), "failure")


def draw_step(ui: Ui, step: Step) -> None:
    """Draw a bar, empty where nobody knows how long it takes, and what is being done."""
    imgui.ProgressBar(step.share() or 0.0, (-1, ui.px(_BAR)), "")
    ui.note(capital(step.words()))

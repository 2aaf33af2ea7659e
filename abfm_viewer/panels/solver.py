"""The solver: the one obvious button, what goes on, and what its end means."""

import polyscope.imgui as imgui

from abfm_viewer.panels import progress, verdict
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui

_STATE_HEIGHT = 130  # six lines, or four and a row of buttons
_STATE_SHARE = 0.3  # of a low panel
_SIDE_BUTTON, _SIDE_SHARE = 76, 0.3
_WARM = "from the current field"


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    _buttons(ui, session)
    height, lines = _state_room(ui.px(_STATE_HEIGHT), _STATE_SHARE * imgui.GetContentRegionAvail()[1])
    with ui.child("state", height, border=False):  # always as high: what is below must not jump
        if session.solver.running:
            progress.draw(ui, session)
        else:
            verdict.draw(context, lines)


def _state_room(wanted: float, room: float) -> tuple[float, int]:
    """The height, and how many lines a low panel has for why a match ended, above the remedies; else 0."""
    if wanted <= room:
        return wanted, 0
    line, spacing = float(imgui.GetTextLineHeight()), float(imgui.GetStyle().ItemSpacing[1])
    least = 2 * line + 2 * spacing + imgui.GetFrameHeight()  # headline, a line, and buttons
    return (least + line, 2) if least + line <= room else (least, 1)


def _buttons(ui: Ui, session: Session) -> None:
    """Each has its own place, so that a click on one that comes when the run has just ended does not hit another."""
    solver, side = session.solver, min(ui.px(_SIDE_BUTTON), _SIDE_SHARE * imgui.GetContentRegionAvail()[0])
    others = 2 * (side + imgui.GetStyle().ItemSpacing[0])
    tip = "Find the field whose flow carries the source to the target (Ctrl+Enter)."
    if session.opening:
        tip = f"{session.opening}: that takes the place of {session.document.name}. Wait, or cancel it."
    ready = not (solver.running or session.obstacle or session.opening)
    if ui.button("Match", tip, primary=True, enabled=ready, width=-others):
        session.match()
    ui.beside()
    tip = "Let the solver go on (P)." if solver.paused else "Hold the solver; the window stays as it is (P)."
    if ui.button("Resume" if solver.paused else "Pause", tip, enabled=solver.running, width=side):
        solver.resume() if solver.paused else solver.pause()
    ui.beside()
    tip = "End the run and keep the best field so far (Esc)."
    if ui.button("Cancel", tip, enabled=solver.running, width=-1):
        solver.cancel()


def draw_switches(ui: Ui, session: Session) -> None:
    """Draw how runs begin: what the parameters do not say."""
    solver = session.solver
    solver.follow = ui.checkbox(
        "restart on changes",
        solver.follow,
        "While it runs, another parameter or function restarts the solver from the field that it has by then. A new "
        "smoothness is taken when the mouse lets go of the slider.",
        name="Restart on changes",
    )
    ui.beside_if_fits(_WARM)
    solver.warm = ui.checkbox(
        _WARM,
        solver.warm,
        "Match goes on from the present result instead of from zero, with σ at its last value. Good after small "
        "changes; start from zero where it got stuck.",
        name="Start from the current field",
    )

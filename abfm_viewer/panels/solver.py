"""The solver: the one obvious button, what goes on, and what its end means."""

import polyscope.imgui as imgui

from abfm_viewer.panels import progress, verdict
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import child
from abfm_viewer.widgets.toolkit import Ui

_STATE_HEIGHT = 130  # six lines, or four and a row of buttons
_STATE_SHARE = 0.3  # of a low panel
_SIDE_BUTTON, _SIDE_SHARE = 76, 0.3
_WARM = "from the current field"


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    _buttons(ui, session)
    room = _STATE_SHARE * imgui.GetContentRegionAvail()[1]
    height, lines = _state_room(ui.px(_STATE_HEIGHT), room)
    with child(ui, "state", height, border=False):  # always as high: what is below must not jump
        if session.solver.running:
            progress.draw(ui, session)
        else:
            verdict.draw(context, lines)


def _state_room(wanted: float, room: float) -> tuple[float, int]:
    """Return the height, and how many lines a low panel has for why a match ended, else 0."""
    if wanted <= room:
        return wanted, 0
    line, spacing = float(imgui.GetTextLineHeight()), float(imgui.GetStyle().ItemSpacing[1])
    least = 2 * line + 2 * spacing + imgui.GetFrameHeight()  # headline, a line, and buttons
    return (least + line, 2) if least + line <= room else (least, 1)


def _buttons(ui: Ui, session: Session) -> None:
    """Draw them where they always are: a click when the run has just ended hits no other."""
    solver = session.solver
    side = min(ui.px(_SIDE_BUTTON), _SIDE_SHARE * imgui.GetContentRegionAvail()[0])
    others = 2 * (side + imgui.GetStyle().ItemSpacing[0])
    tip = "Find the field whose flow carries the source to the target (Ctrl+Enter)."
    if session.result is not None and not solver.warm:
        tip += " It begins anew, from no motion."
    if session.loading.replacing:
        name = session.document.name
        tip = f"{session.loading.replacing}: that takes the place of {name}. Wait, or cancel it."
    ready = not (solver.running or session.obstacle or session.loading.replacing)
    if ui.button("Match", tip, primary=True, enabled=ready, width=-others):
        session.match()
    ui.beside()
    label, tip = "Pause", "Hold the solver; the window stays as it is (P)."
    if solver.paused:
        label, tip = "Resume", "Let the solver go on (P)."
    if ui.button(label, tip, enabled=solver.running, width=side):
        solver.resume() if solver.paused else solver.pause()
    ui.beside()
    tip = "End the run and keep the best field so far (Esc); Continue goes on from it."
    if ui.button("Cancel", tip, enabled=solver.running, width=-1):
        solver.cancel()


def draw_switches(ui: Ui, session: Session) -> None:
    """Draw how runs begin: what the parameters do not say."""
    solver = session.solver
    solver.follow = ui.checkbox(
        "restart on changes##Restart on changes",
        solver.follow,
        "While it runs, another parameter or function restarts the solver from the field that it "
        "has by then. A new smoothness is taken when the mouse lets go of the slider.",
    )
    ui.beside_if_fits(_WARM)
    solver.warm = ui.checkbox(
        f"{_WARM}##Start from the current field",
        solver.warm,
        "Match goes on from the present result instead of from zero, with σ at its last value. "
        "Good after small changes; start from zero where it got stuck.",
    )

"""The status line."""

import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document.verdict_words import headline, place
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.widget_record import Rect


def draw(context: Context, rect: Rect) -> None:
    """Draw a notice or what goes on, and at the right the mesh's name and size and the frames per second."""
    ui, session = context.ui, context.session
    with ui.window("status line", rect):
        left, right = imgui.GetCursorPosX(), imgui.GetCursorPosX() + imgui.GetContentRegionAvail()[0]
        name = cut(session.document.name, (right - left) / 3, _width)
        details = f"{name}   {len(session.mesh.vertices):,} vertices   {imgui.GetIO().Framerate:.0f} fps"
        start = right - imgui.CalcTextSize(details)[0] - ui.px(2)  # else a fraction of a pixel makes it two lines
        text = "" if session.notice.is_error else session.notice.text  # errors are cards in the viewport
        text = text or _state(context)
        shown = cut(text, start - left - ui.px(16), _width)
        ui.note(shown, "ink")
        if shown != text:
            ui.tip(text)
        imgui.SameLine(start)
        ui.note(details)


def _state(context: Context) -> str:
    session, solver, result = context.session, context.session.solver, context.session.result
    if solver.running:
        if (snapshot := solver.snapshot) is None:
            return solver.step.words() if solver.step else "starting the solver"
        state = "paused" if solver.paused else "solving"
        return f"{state}, {place(snapshot.iteration)}, mismatch {snapshot.iteration.mismatch:.3g}"
    if context.shown.busy:
        return context.shown.busy
    if solver.failed:
        return f"the solver stopped: {solver.reason}"
    return f"{headline(result)}{', outdated' if session.outdated else ''}" if result else "ready"


def _width(text: str) -> float:
    return float(imgui.CalcTextSize(text)[0])

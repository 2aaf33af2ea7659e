"""The status line."""

import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document.verdict_words import left_now, place
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.intervals import confirmed
from abfm_viewer.widgets.containers import window
from abfm_viewer.widgets.widget_record import Rect


def draw(context: Context, rect: Rect) -> None:
    """Draw a notice or what goes on; at the right the mesh, its size and frames per second."""
    ui, session = context.ui, context.session
    with window(ui, "status line", rect):
        left = imgui.GetCursorPosX()
        right = left + imgui.GetContentRegionAvail()[0]
        name = cut(session.document.name, (right - left) / 3, ui.text_width)
        sizes = (f"{len(one.mesh.vertices):,}" for one in session.document.surfaces)
        size = f"{' and '.join(sizes)} vertices"
        details = f"{name}   {size}   {imgui.GetIO().Framerate:.0f} fps"
        start = right - ui.text_width(details) - ui.px(2)
        # errors are cards in the viewport
        text = "" if session.notices.latest.is_error else session.notices.latest.text
        ui.line(text or _state(context), "ink", room=start - left - ui.px(16))
        imgui.SameLine(start)
        ui.line(details)


def _state(context: Context) -> str:
    session, solver = context.session, context.session.solver
    if solver.running:
        if (snapshot := solver.snapshot) is None:
            return solver.step.words() if solver.step else "starting the solver"
        state = "paused" if solver.paused else "solving"
        left = left_now(snapshot.iteration, snapshot.problem.is_of_landmarks)
        return f"{state}, {place(snapshot.iteration)}, {left}"
    if session.film_match.running:
        return session.film_match.words(session.document)
    is_playing = session.document.film is not None and session.player.playing
    if context.shown.busy and not is_playing:  # else it would flicker
        return context.shown.busy
    if is_playing and context.shown.quantities.convolving:
        return "computing streaks; each interval has them when it is played again"
    if session.document.sequence is not None:
        told = confirmed(session.document.sequence)
        return f"{told}{', outdated' if session.document.is_film_outdated else ''}"
    if solver.failed:
        return f"the solver stopped: {solver.reason}"
    return (
        f"{session.facts.headline}{', outdated' if session.outdated else ''}"
        if session.facts
        else "ready"
    )

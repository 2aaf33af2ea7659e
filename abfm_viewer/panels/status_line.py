"""The status line."""

from collections.abc import Sequence
from itertools import product

import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import window
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_DETAILS_GAP = 16  # between text and details, at a scale of 1


def draw(context: Context, rect: Rect) -> None:
    """Draw a notice or the current activity; at the right the mesh, its size and the frame rate."""
    ui, session = context.ui, context.session
    with window(ui, "status line", rect):
        left = imgui.GetCursorPosX()
        room = imgui.GetContentRegionAvail()[0] - ui.px(2)
        # errors are cards in the viewport
        text = "" if session.notices.latest.is_error else session.notices.latest.text
        texts = (text,) if text else _state(context)
        text, details = _fitting(ui, texts, _details(ui, session, room), room)
        start = left + room - ui.text_width(details)
        ui.line(text, "ink", room=(start - left - ui.px(_DETAILS_GAP)) if details else room)
        if details:
            imgui.SameLine(start)
            ui.line(details)


def _details(ui: Ui, session: Session, room: float) -> tuple[str, ...]:
    name = abbreviated(session.document.name, room / 3, ui.text_width)
    sizes = (f"{len(one.mesh.vertices):,}" for one in session.document.surfaces)
    size = f"{name}   {' and '.join(sizes)} vertices"
    return f"{size}   {imgui.GetIO().Framerate:.0f} fps", size, name, ""


def _fitting(ui: Ui, texts: Sequence[str], details: Sequence[str], room: float) -> tuple[str, str]:
    """Return the longest text that fits into ``room`` pixels, with the longest details."""
    for text, more in product(texts, details):
        if ui.text_width(text) + ui.text_width(more) + ui.px(_DETAILS_GAP) * (more != "") <= room:
            return text, more
    return texts[-1], ""


def _state(context: Context) -> tuple[str, ...]:
    """Return texts about the current activity or the result, from longest to shortest."""
    session = context.session
    if session.solver.running:
        return (session.work.progress,)
    # a sequence is played while the quantities of later intervals are still being computed
    is_playing = session.player.playing and not session.document.has_one_field
    if context.shown.busy and not is_playing:  # otherwise the line would flicker
        return (context.shown.busy,)
    if is_playing and context.shown.quantities.convolving:
        return ("computing streaks; they are shown when the interval is played again",)
    if session.solver.failed:
        return f"the solver stopped: {session.solver.reason}", "the solver stopped"
    if (reported := session.work.facts) is None:
        return ("ready",)
    outdated = ", outdated" if session.outdated else ""
    texts = reported.headline, reported.short_headline, reported.outcome
    return tuple(f"{text}{outdated}" for text in texts)

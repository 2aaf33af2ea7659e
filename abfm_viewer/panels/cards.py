"""Cards over the surfaces: errors with their remedies, and the progress of long operations."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import polyscope.imgui as imgui

from abfm.wording import capital
from abfm_viewer.appearance.theme import Color
from abfm_viewer.document.keyboard import hint
from abfm_viewer.panels.context import Context
from abfm_viewer.session.notices import Card
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import card
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_CARDS_MAX = 2  # shown at once
# The following lengths are in pixels at a scale of 1.
_WIDTH = 460
_EDGE = 10
_HEIGHT_MIN = 90  # of the area of cards below the names of surfaces
_HEIGHT_OF_SEVERAL = 150
_CARD_DELAY_SECONDS = 0.3  # shorter operations have no card


@dataclass(frozen=True)
class _Work:
    name: str
    text: str
    elapsed: float  # seconds
    share: float | None  # None if the progress is unknown
    step: str = ""
    cancel: Callable[[], None] | None = None
    tip: str = ""  # of the button Cancel


def draw(context: Context, rect: Rect, captions: Sequence[Rect]) -> None:
    """Draw operations in progress, and above them the latest cards, in an area of the window.

    They lie at the bottom right. They do not cover ``captions``, the names of the surfaces.
    """
    ui, cards = context.ui, context.session.notices.cards
    drawn: list[tuple[str, Color, Callable[[], None]]] = [
        (work.name, ui.colors.accent, partial(_draw_work, ui, work))
        for work in (_opening(context.session), _ending(context))
        if work is not None and work.elapsed > _CARD_DELAY_SECONDS
    ]
    left, top, right, bottom = area(rect, captions, ui.scale)
    count = _CARDS_MAX if bottom - top >= ui.px(_HEIGHT_OF_SEVERAL) else 1
    for number, message in enumerate(cards[:count], 1):
        more = len(cards) - count if number == count else 0
        do = partial(_draw_message, context, message, more)
        drawn.append((f"message {number}", ui.colors.failure, do))
    for name, color, draw_card in drawn:
        with card(ui, name, (left, bottom, right - left), color, bottom - top):
            draw_card()
            bottom = float(imgui.GetWindowPos()[1]) - ui.px(_EDGE / 2)


def area(rect: Rect, captions: Sequence[Rect], scale: float) -> Rect:
    """Return the area of the cards: below all captions of the scene, or above them if too low."""
    edge, (left, top, right, bottom) = _EDGE * scale, rect
    begin, end = max(right - _WIDTH * scale, left) + edge, right - edge
    if captions and all(one[2] < (left + right) / 2 for one in captions):  # left of the surfaces
        begin = max(begin, *(one[2] for one in captions))
    over = [one for one in captions if one[0] < end and begin < one[2]]
    lowest = max((one[3] for one in over), default=top) + edge
    highest = min((one[1] for one in over), default=bottom) - edge
    bottom -= edge
    if bottom - lowest < min(_HEIGHT_MIN * scale, highest - top):
        return begin, top + edge, end, highest
    return begin, lowest, end, bottom


def _draw_message(context: Context, message: Card, more: int) -> None:
    ui, notices = context.ui, context.session.notices
    ui.note(message.text, "ink")
    remedies = notices.remedies_for(message)
    labels = [*remedies, "Dismiss"]
    for number, (label, do) in enumerate(remedies.items()):
        if ui.button(label, primary=number == 0):
            notices.dismiss(message)
            do()
        ui.same_line_if_fits(labels[number + 1])
    if ui.button(
        "Dismiss", f"Remove this message ({hint('cancel')}). Help, Messages lists all messages."
    ):
        notices.dismiss(message)
    if more > 0:
        ui.note(f"and {more} more: Help > Messages")


def _opening(session: Session) -> _Work | None:
    """Return the progress of opening a file, or of computing a mesh's first functions, or None."""
    load = session.loading.now
    if load is not None and load.elapsed > _CARD_DELAY_SECONDS:
        text = f"{load.what}: {load.elapsed:.0f} s"
        cancel, tip = session.loading.cancel, "Do not open it."
        return _Work("opening", text, load.elapsed, None, cancel=cancel, tip=tip)
    if session.functions.waiting_since is None:
        return None
    elapsed = time.perf_counter() - session.functions.waiting_since
    share = session.step.share() if session.step else None
    return _Work("functions", session.busy or "computing functions", elapsed, share)


def _ending(context: Context) -> _Work | None:
    if (waiting := context.files.waiting) is None:
        return None
    step, elapsed = context.session.solver.overall.step, waiting.elapsed
    text = f"{waiting.what} when the run has ended: {elapsed:.0f} s"
    doing = step.task if step else "taking its best field"
    tip = "Keep the current document. The run still ends, with its best field."
    return _Work("ending the run", text, elapsed, None, doing, context.files.stop_waiting, tip)


def _draw_work(ui: Ui, work: _Work) -> None:
    """Draw an operation; its progress bar is animated if the progress is unknown."""
    ui.note(capital(work.text), "ink")
    share = -0.5 * work.elapsed if work.share is None else work.share
    imgui.ProgressBar(share, (-1, ui.px(8)), "")
    if work.step:
        ui.note(capital(work.step))
    if work.cancel is not None and ui.button("Cancel", work.tip):
        work.cancel()

"""Cards over the surfaces: what went wrong, what can be done about it, what one waits for."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import polyscope.imgui as imgui

from abfm_viewer.appearance.theme import Color
from abfm_viewer.document.verdict_words import capital
from abfm_viewer.panels.context import Context
from abfm_viewer.session.notices import Card
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import card
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

MOST = 3
"""Cards that are shown at once."""
LOADING = "opening"
"""Where Cancel is, for the Driver."""
FUNCTIONS = "functions"
"""The card of a mesh whose functions are still to come."""
WAITING = "ending the run"
"""The same while something waits for that."""
_WIDTH, _EDGE = 460, 10
_SUDDENLY = 0.3  # seconds that something may take without a card


@dataclass(frozen=True)
class _Work:
    """What goes on, and what Cancel does, with its tooltip; a share that nobody knows is None."""

    name: str
    text: str
    elapsed: float
    share: float | None
    doing: str = ""
    cancel: Callable[[], None] | None = None
    tip: str = ""


class _Column:
    """Places cards one below the other, in the middle of a rectangle of the window."""

    def __init__(self, ui: Ui, rect: Rect) -> None:
        self._ui = ui
        self._left, self._top, self._right, self._bottom = rect
        self._top += ui.px(_EDGE)

    @contextmanager
    def card(self, name: str, color: Color) -> Iterator[None]:
        ui = self._ui
        width = min(ui.px(_WIDTH), self._right - self._left - 2 * ui.px(_EDGE))
        place = (self._left + self._right - width) / 2, self._top, width
        with card(ui, name, place, color, self._bottom - self._top):
            yield
            end = imgui.GetWindowPos()[1] + imgui.GetWindowHeight()
        self._top = float(end) + ui.px(_EDGE / 2)


def draw(context: Context, rect: Rect) -> None:
    """Draw what one waits for and the latest cards below it, in a rectangle of the window."""
    column, cards = _Column(context.ui, rect), context.session.notices.cards
    for work in (_opening(context.session), _ending(context)):
        if work is not None and work.elapsed > _SUDDENLY:
            with column.card(work.name, context.ui.colors.accent):
                _draw_work(context.ui, work)
    for number, message in enumerate(cards[:MOST], 1):
        with column.card(f"message {number}", context.ui.colors.failure):
            _draw_message(context, message)
            if number == MOST < len(cards):
                context.ui.note(f"and {len(cards) - MOST} more")


def _draw_message(context: Context, message: Card) -> None:
    ui, session = context.ui, context.session
    ui.note(message.text, "ink")
    remedies = session.notices.offered(message)
    labels = [*remedies, "Dismiss"]
    for number, (label, do) in enumerate(remedies.items()):
        if ui.button(label, primary=number == 0):
            session.notices.dismiss(message)
            do()
        ui.beside_if_fits(labels[number + 1])
    if ui.button("Dismiss", "Take this message away (Esc). Help, Messages has all of them."):
        session.notices.dismiss(message)


def _opening(session: Session) -> _Work | None:
    """Return what is being opened, or how far the first functions of a mesh are."""
    load = session.loading.now
    if load is not None and load.elapsed > _SUDDENLY:
        text = f"{load.what}: {load.elapsed:.0f} s"
        cancel, tip = session.loading.cancel, "Go on without it."
        return _Work(LOADING, text, load.elapsed, None, cancel=cancel, tip=tip)
    if session.functions.bare_since is None:
        return None
    elapsed = time.perf_counter() - session.functions.bare_since
    share = session.step.share() if session.step else None
    return _Work(FUNCTIONS, session.busy or "computing functions", elapsed, share)


def _ending(context: Context) -> _Work | None:
    """Return what begins when the run has ended."""
    if (waiting := context.files.waiting) is None:
        return None
    step, elapsed = context.session.solver.step, waiting.elapsed
    text = f"{waiting.what} when the run has ended: {elapsed:.0f} s"
    share, doing = (step.share(), step.words()) if step else (None, "taking its best field")
    tip = "Not now. The run ends all the same, with its best field."
    return _Work(WAITING, text, elapsed, share, doing, context.files.stop_waiting, tip)


def _draw_work(ui: Ui, work: _Work) -> None:
    """Draw what goes on, with a bar that runs where nobody knows how far it is."""
    ui.note(capital(work.text), "ink")
    share = -0.5 * work.elapsed if work.share is None else work.share
    imgui.ProgressBar(share, (-1, ui.px(8)), "")
    if work.doing:
        ui.note(capital(work.doing))
    if work.cancel is not None and ui.button("Cancel", work.tip):
        work.cancel()

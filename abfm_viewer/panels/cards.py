"""Cards at the top of the viewport: what went wrong, what can be done about it, and what one waits for."""

import time
from collections.abc import Callable

import polyscope.imgui as imgui

from abfm_viewer.document.wording import capital
from abfm_viewer.panels.context import Context
from abfm_viewer.session.loading import Load
from abfm_viewer.session.notices import Card
from abfm_viewer.session.waiting import Waiting
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
_ALMOST = 0.97  # of a progress bar: an estimate is no promise


def draw(context: Context, rect: Rect) -> None:
    """Draw what one waits for and the latest cards below it, in a rectangle of the window."""
    ui, session = context.ui, context.session
    top = rect[1] + ui.px(_EDGE)
    if (load := session.loading) is not None and load.elapsed > _SUDDENLY:
        top = _draw_loading(context, load, rect, top)
    elif session.bare_since is not None and (since := time.perf_counter() - session.bare_since) > _SUDDENLY:
        top = _draw_functions(context, since, rect, top)
    if (waiting := context.files.waiting) is not None and waiting.elapsed > _SUDDENLY:
        top = _draw_waiting(context, waiting, rect, top)
    shown = session.cards[:MOST]
    for number, card in enumerate(shown, 1):
        more = len(session.cards) - MOST if number == MOST else 0
        top = _draw_card(context, card, number, more, rect, top)


def _draw_card(context: Context, card: Card, number: int, more: int, rect: Rect, top: float) -> float:
    """Draw one, and those that are not shown in a line; where the next one begins."""
    ui, session = context.ui, context.session
    name = f"message {number}"
    with ui.card(name, _place(ui, rect, top), ui.colors.failure, rect[3] - top), ui.group(name):
        ui.note(card.text, "ink")
        remedies = session.offered(card)
        following = [*remedies, "Dismiss"][1:]
        for (label, do), next_label in zip(remedies.items(), following, strict=True):
            if ui.button(label, primary=label == next(iter(remedies))):
                session.dismiss(card)
                do()
            ui.beside_if_fits(next_label)
        if ui.button("Dismiss", "Take this message away (Esc). Help, Messages has all of them."):
            session.dismiss(card)
        if more > 0:
            ui.note(f"and {more} more")
        return _below(ui)


def _draw_loading(context: Context, load: Load, rect: Rect, top: float) -> float:
    """Draw what is being opened; where the next card begins."""
    about = f" of about {load.seconds:.0f} s" if load.seconds else ""
    text = f"{capital(load.what)}: {load.elapsed:.0f} s{about}"
    share = min(load.elapsed / load.seconds, _ALMOST) if load.seconds else None
    cancel = ("Go on without it.", context.session.cancel_loading)
    return _draw_work(context.ui, LOADING, text, share, load.elapsed, rect, top, cancel=cancel)


def _draw_functions(context: Context, since: float, rect: Rect, top: float) -> float:
    """Draw how far the first functions of a mesh are, after so many seconds; where the next card begins."""
    session = context.session
    share = session.step.share() if session.step else None
    return _draw_work(context.ui, FUNCTIONS, session.busy or "computing functions", share, since, rect, top)


def _draw_waiting(context: Context, waiting: Waiting, rect: Rect, top: float) -> float:
    """Draw what begins when the run has ended; where the next card begins."""
    step, elapsed = context.session.solver.step, waiting.elapsed
    text = f"{capital(waiting.what)} when the run has ended: {elapsed:.0f} s"
    share, doing = (step.share(), step.words()) if step else (None, "taking its best field")
    cancel = ("Not now. The run ends all the same, with its best field.", context.files.stop_waiting)
    return _draw_work(context.ui, WAITING, text, share, elapsed, rect, top, doing, cancel)


def _draw_work(
    ui: Ui,
    name: str,
    text: str,
    share: float | None,
    elapsed: float,
    rect: Rect,
    top: float,
    doing: str = "",
    cancel: tuple[str, Callable[[], None]] | None = None,
) -> float:
    """Draw what goes on, with a bar that runs where nobody knows how far it is; where the next card begins."""
    with ui.card(name, _place(ui, rect, top), ui.colors.accent, rect[3] - rect[1]), ui.group(name):
        ui.note(capital(text), "ink")
        imgui.ProgressBar(-0.5 * elapsed if share is None else share, (-1, ui.px(8)), "")
        if doing:
            ui.note(capital(doing))
        if cancel is not None:
            tip, do = cancel
            if ui.button("Cancel", tip):
                do()
        return _below(ui)


def _below(ui: Ui) -> float:
    """Where the card after the one that is being drawn begins."""
    return float(imgui.GetWindowPos()[1] + imgui.GetWindowHeight()) + ui.px(_EDGE / 2)


def _place(ui: Ui, rect: Rect, top: float) -> tuple[float, float, float]:
    """Left end, top and width of a card: in the middle of the viewport."""
    width = min(ui.px(_WIDTH), rect[2] - rect[0] - 2 * ui.px(_EDGE))
    return (rect[0] + rect[2] - width) / 2, top, width

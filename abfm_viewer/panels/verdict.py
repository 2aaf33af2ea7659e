"""What the latest match came to: how well it matches, why it stopped, and remedies that one click carries out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document import verdict_words
from abfm_viewer.document.wording import capital, sentence
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.texts import Kind
from abfm_viewer.widgets.toolkit import Ui

if TYPE_CHECKING:
    from abfm import Match

_MOST_LINES = 2  # for why it stopped, or cannot start
_ABOUT = "Match finds a flow from the source to the target"


def draw(context: Context, lines: int = 0) -> None:
    """Draw it; in a low panel with so many lines for why it stopped, and remedies before numbers."""
    ui, session = context.ui, context.session
    result, solver = session.result, session.solver
    if solver.failed:
        _line(ui, f"The solver stopped: {solver.reason}", "failure", _MOST_LINES)
    elif result is None:
        failed = any(session.error(spec) for spec in session.specs)
        _line(ui, "No match yet", "ink")
        _line(ui, sentence(session.obstacle or _ABOUT), "failure" if failed else "muted", _MOST_LINES)
    if result is None:
        return
    tone = verdict_words.tone(result)
    _line(ui, capital(verdict_words.headline(result)), "muted" if session.outdated else tone)
    if steps := len(result.energy_history) - 1:
        _right(ui, verdict_words.counted(steps, "iteration"))
    why = "functions or parameters changed since" if session.outdated else verdict_words.why(result)
    _line(ui, sentence(why), "ink", lines or _MOST_LINES)
    numbers = f"Mismatch {verdict_words.numbers(result)}"
    if lines:
        _remedies(ui, session, result, 1)
        _line(ui, numbers, "muted")
    else:
        _line(ui, numbers, "muted", 1 if verdict_words.advice(result) or session.outdated else _MOST_LINES)
        _remedies(ui, session, result, _MOST_LINES)


def _remedies(ui: Ui, session: Session, result: Match, lines: int) -> None:
    """Draw buttons, or what to try where no button can do it in so many lines."""
    with ui.group("verdict"):
        _buttons(ui, session, result)
    advice = verdict_words.advice(result)
    if advice and not (result.verdict.remedies or session.outdated):
        _line(ui, f"To try: {advice}.", "muted", lines)


def _buttons(ui: Ui, session: Session, result: Match) -> None:
    if session.outdated:
        if ui.button(
            "Match again", "Match the functions and parameters as they are now.", enabled=not session.obstacle
        ):
            session.match()
        if session.obstacle:
            ui.beside()
            _line(ui, sentence(session.obstacle), "failure")
        return
    for number, remedy in enumerate(result.verdict.remedies):
        if number:
            ui.beside_if_fits(remedy.label, is_button=True)
        if ui.button(remedy.label, verdict_words.changes(remedy)):
            session.remedy(remedy)


def _line(ui: Ui, text: str, kind: Kind, most: int = 1) -> None:
    """A line, or at most some; what has no room is in a tooltip."""
    width = imgui.GetContentRegionAvail()[0]
    shown = cut(
        text, most * imgui.GetTextLineHeight() + 1, lambda part: float(imgui.CalcTextSize(part, False, width)[1])
    )
    ui.note(shown, kind)
    if shown != text:
        ui.tip(text)


def _right(ui: Ui, text: str) -> None:
    """Something at the end of the line, if there is room."""
    start = imgui.GetCursorPosX() + imgui.GetContentRegionAvail()[0] - imgui.CalcTextSize(text)[0] - ui.px(2)
    if imgui.GetWindowPos()[0] + start > imgui.GetItemRectMax()[0] + ui.px(8):
        imgui.SameLine(start)
        ui.note(text)

"""What the latest match came to: how well it matches, why it stopped, and remedies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document import verdict_words
from abfm_viewer.document.verdict_words import capital, sentence
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Kind, Ui

if TYPE_CHECKING:
    from abfm import Match

_MOST_LINES = 2  # for why it stopped, or cannot start
_ABOUT = "Match finds a flow from the source to the target"


def draw(context: Context, lines: int = 0) -> None:
    """Draw it; a low panel has so many lines for why it stopped, and remedies before numbers."""
    ui, session = context.ui, context.session
    result, solver = session.result, session.solver
    if solver.failed:
        _line(ui, f"The solver stopped: {solver.reason}", "failure", _MOST_LINES)
    elif result is None:
        failed = session.functions.problem(session.document) != ""
        about = sentence(session.obstacle or _ABOUT)
        _line(ui, "No match yet", "ink")
        _line(ui, about, "failure" if failed else "muted", _MOST_LINES)
    if result is None:
        return
    outdated = session.outdated
    tone = "muted" if outdated else verdict_words.tone(result)
    _line(ui, capital(verdict_words.headline(result)), tone)
    if steps := len(result.energy_history) - 1:
        _right(ui, verdict_words.counted(steps, "iteration"))
    why = "functions or parameters changed since" if outdated else verdict_words.why(result)
    _line(ui, sentence(why), "ink", lines or _MOST_LINES)
    numbers = f"Mismatch {verdict_words.numbers(result)}"
    if lines:
        _remedies(ui, session, result, 1)
        _line(ui, numbers, "muted")
    else:
        has_more = outdated or verdict_words.advice(result)
        _line(ui, numbers, "muted", 1 if has_more else _MOST_LINES)
        _remedies(ui, session, result, _MOST_LINES)


def _remedies(ui: Ui, session: Session, result: Match, lines: int) -> None:
    """Draw buttons, or what to try where no button can do it in so many lines."""
    with ui.group("verdict"):
        if session.outdated:
            _match_again(ui, session, result)
            return
        remedies = result.verdict.remedies
        for number, remedy in enumerate(remedies):
            if number:
                ui.beside_if_fits(remedy.label, is_button=True)
            if ui.button(remedy.label, verdict_words.changes(remedy)):
                session.remedy(remedy)
        # copies of a run, and older files, have no remedies
        if not remedies and verdict_words.is_broken_off(result):
            _go_on(ui, session)
    advice = verdict_words.advice(result)
    if advice and (result.verdict.kind == "impossible" or not result.verdict.remedies):
        _line(ui, f"To try: {advice}.", "muted", lines)
    elif verdict_words.is_broken_off(result):
        _line(ui, "Continue, or Match starts over.", "muted", lines)


def _match_again(ui: Ui, session: Session, result: Match) -> None:
    """Draw what there is to do after another problem than the present one."""
    can_start = not session.obstacle
    tip = "Match the functions and parameters as they are now."
    if ui.button("Match again", tip, enabled=can_start):
        session.match()
    if verdict_words.is_broken_off(result):
        ui.beside_if_fits("Continue", is_button=True)
        _go_on(ui, session)
    if session.obstacle:
        ui.beside()
        _line(ui, sentence(session.obstacle), "failure")


def _go_on(ui: Ui, session: Session) -> None:
    tip = "Match from the field that was found."
    if ui.button("Continue", tip, enabled=not session.obstacle):
        session.match(goes_on=True)


def _line(ui: Ui, text: str, kind: Kind, most: int = 1) -> None:
    """Write a line, or at most some; what has no room is in a tooltip."""
    width, room = imgui.GetContentRegionAvail()[0], most * imgui.GetTextLineHeight() + 1
    shown = cut(text, room, lambda part: float(imgui.CalcTextSize(part, False, width)[1]))
    ui.note(shown, kind)
    if shown != text:
        ui.tip(text)


def _right(ui: Ui, text: str) -> None:
    """Write something at the end of the line, if there is room."""
    end = imgui.GetCursorPosX() + imgui.GetContentRegionAvail()[0]
    start = end - ui.text_width(text) - ui.px(2)
    if imgui.GetWindowPos()[0] + start > imgui.GetItemRectMax()[0] + ui.px(8):
        imgui.SameLine(start)
        ui.note(text)

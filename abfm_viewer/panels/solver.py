"""The solver: its buttons, the progress of a run, and the verdict of the result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import polyscope.imgui as imgui

import abfm
from abfm.outcome import Facts, Outcome, WarningTopic
from abfm.wording import capital, counted, sentence, share
from abfm.workers.progress import Overall, Step
from abfm_viewer.document import verdict_words
from abfm_viewer.document.comparison import Comparison
from abfm_viewer.document.keyboard import hint, with_key
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import OUTCOME, draw_help, note_with_help
from abfm_viewer.panels.trade_off import LIMIT, draw_limit
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import Fits, child, menu_button, menu_item
from abfm_viewer.widgets.toolkit import Ui

# minimum height of the state, so that the parts below seldom move: six lines of text, or four
# lines and a row of buttons
_STATE_HEIGHT = 130
_STATE_SHARE = 0.3  # maximum height of the state, as a share of the panel
_SIDE_BUTTON = 76
_DETAIL_SECONDS = 1.0  # a step of this duration is shown instead of the stage
_BAR_HEIGHT = 8  # of progress bars, as on cards; leaves space for three lines and a warning
_IMPOSSIBLE_NOTE = "No flow can match these functions."
_START_MENU = "start options"
_FOLLOW_TIPS = {
    "follow changes": "A changed function or parameter applies at once: the run continues from its "
    "current field. A new smoothness applies when the mouse button is released.",
    "ignore changes": "Changed functions and parameters apply to the next match.",
}
_AGAIN_TIP = "Match the current functions with the current parameters, from zero."
_CONTINUE_TIP = (
    "Start from the field of the result, with σ at its last value. Use it after an interrupted run "
    "or small changes, but not if the solver was stuck."
)


def draw(context: Context, draw_state: Callable[[Context], None]) -> None:
    """Draw the buttons of the solver, and the state of its run or of the result."""
    ui, session = context.ui, context.session
    _draw_buttons(ui, session)
    height = min(ui.px(_STATE_HEIGHT), _STATE_SHARE * imgui.GetContentRegionAvail()[1])
    if session.steps.busy:  # keep the height, so that nothing moves under the mouse
        height = max(height, ui.heights.get("state", 0.0))
    # during a run no text needs to be completely visible
    fits: Fits = "exactly" if session.solver.running else "at least"
    with child(ui, "state", height, border=False, fits=fits):
        if (row := context.files.tables.unshown_row) is not None:
            note_with_help(context, f"{row.name}: {row.verdict}", row.facts.tone, row.facts.topics)
            ui.note(sentence(row.facts.reason or "it has no result yet"), "ink")
            ui.note(f"The surfaces still show {session.document.name}.")
        else:
            draw_state(context)


def draw_subject(context: Context) -> None:
    """Draw the state of a subject's match, or else the verdict of the subject in its population."""
    session = context.session
    compared, solver = session.document.active_comparison, session.solver
    if compared is None or solver.running or solver.failed or session.result is not None:
        draw_match(context)
    else:
        _draw_compared(context, compared)


def draw_match(context: Context) -> None:
    if context.session.solver.running:
        _draw_progress(context.ui, context.session)
    else:
        _draw_verdict(context)


def _draw_buttons(ui: Ui, session: Session) -> None:
    """Draw the buttons at fixed places, so that a late click cannot hit another button."""
    document, replacing = session.document, session.loading.replacing
    solver = session.solver
    room, spacing = imgui.GetContentRegionAvail()[0], imgui.GetStyle().ItemSpacing[0]
    arrow = imgui.GetFrameHeight() + ui.px(2)
    widest = max(map(ui.text_width, (document.match_label, "Match again")))
    side = (room - arrow - widest) / 2 - imgui.GetStyle().FramePadding[0] - spacing
    side = min(ui.px(_SIDE_BUTTON), max(side, ui.text_width("Resume") + ui.px(4)))
    others = 2 * (side + spacing)
    has_result, continues = session.result is not None, session.work.continues
    tips = _AGAIN_TIP if has_result else document.match_tip, _CONTINUE_TIP
    tip = with_key(tips[has_result and continues], "match")
    other_tip = with_key(tips[not continues], "match otherwise")
    if replacing:
        tip = f"{replacing} will replace {document.name}. Wait, or cancel it."
    label = f"{session.match_label}##{document.match_label}"
    if ui.button(label, tip, primary=True, enabled=session.can_match, width=-others - arrow):
        session.match(continues)
    ui.same_line(ui.px(2))
    enabled, other = session.can_match_otherwise, session.other_match_label
    with menu_button(ui, _START_MENU, f"{other}.", enabled) as is_open:
        if is_open:
            if menu_item(ui, session.match_label, hint("match")):
                session.match(continues)
            ui.tip(tip)
            if menu_item(ui, other, hint("match otherwise")):
                session.match(not continues)
            ui.tip(other_tip)
    ui.same_line()
    label, tip = "Pause", with_key("Pause the solver.", "pause")
    if solver.paused:
        label, tip = "Resume", with_key("Resume the solver.", "pause")
    with ui.disabled(not solver.running, "No match is running."):
        if ui.button(label, tip, width=side):
            solver.toggle()
        ui.same_line()
        if ui.button("Cancel", document.cancel_tip, width=-1):
            solver.cancel()


def draw_switch(ui: Ui, session: Session) -> None:
    matching, (follow, wait) = session.matching, _FOLLOW_TIPS
    now = follow if matching.follow else wait
    tip = "What a changed function or parameter does during a run."
    matching.follow = ui.combo("during a run", now, _FOLLOW_TIPS, tip) == follow


def _draw_progress(ui: Ui, session: Session) -> None:
    solver = session.solver
    snapshot, overall = session.matching.snapshot, solver.overall
    if snapshot is None:
        draw_overall(ui, overall)
        ui.note(capital(overall.detail()))
        return
    now = snapshot.iteration
    draw_overall(ui, overall, verdict_words.attempt_text(now))
    residual = verdict_words.residual_text(now)
    best = verdict_words.best_text(now, snapshot.others.values())
    ui.note(f"Iteration {now.iteration}, {residual}{best}")
    ui.note(capital(overall.detail(_DETAIL_SECONDS) or verdict_words.stage_text(now)))
    if now.warning:
        ui.note(sentence(now.warning), "failure")


def draw_overall(ui: Ui, overall: Overall, part: str = "") -> None:
    """Draw the progress of a task: a bar, and its phase with the remaining time."""
    _draw_bar(ui, overall.share(), overall.began)
    ui.note(capital(", ".join(filter(None, (overall.name, part, overall.text())))), "ink")


def draw_step(ui: Ui, step: Step) -> None:
    """Draw the progress bar and the text of a step."""
    _draw_bar(ui, step.share(), step.began)
    ui.note(capital(step.text()))


def _draw_bar(ui: Ui, share: float | None, began: float) -> None:
    """Draw a progress bar; it is animated if the share is unknown."""
    animated = -0.5 * (time.monotonic() - began)
    imgui.ProgressBar(animated if share is None else share, (-1, ui.px(_BAR_HEIGHT)), "")


def draw_sequence(context: Context) -> None:
    ui, session = context.ui, context.session
    document, run = session.document, session.sequence_match
    assert isinstance(document, SequenceDocument)
    sequence, result = document.sequence, document.result
    if session.solver.running:
        draw_overall(ui, session.solver.overall)
        found = run.found_count(document)
        ui.note(f"Intervals found: {found} of {sequence.intervals}", "ink")
        return
    if result is None:
        ui.note("No match yet", "ink")
        ui.note("Match finds the fields that advect each frame to the next, all in one run.")
        return
    outdated = document.is_outdated
    facts = result.facts
    now = document.interval
    verdict = result.verdicts[now]
    topics = *facts.topics, *({verdict.topic} - {*facts.topics})
    note_with_help(context, capital(facts.headline), "muted" if outdated else facts.tone, topics)
    if outdated:
        ui.note("Frames or parameters have changed. Match all frames again.", "ink")
    interval = abfm.sequences.interval_headline(result, now)
    first, last = sequence.numbers[now : now + 2]
    ui.note(f"Frame {first} to {last}: {interval}", "muted" if outdated else verdict.kind.tone)
    if reason := verdict.why or verdict.reason:
        ui.note(sentence(reason))


def _draw_verdict(context: Context) -> None:
    ui, session = context.ui, context.session
    result, solver = session.result, session.solver
    if solver.failed:
        ui.note(f"The solver stopped: {solver.reason}", "failure")
    elif result is None:
        _draw_before(context)
    if result is not None and session.steps.busy:
        ui.note(f"Step {session.steps.shown + 1} of {len(result.path)}: computing")
    elif result is not None and (facts := session.work.facts) is not None:
        _draw_result(context, result, facts)


def _draw_before(context: Context) -> None:
    ui, session = context.ui, context.session
    facts, overall = session.work.expected_facts, session.work.overall
    if overall is not None and facts is None:
        draw_overall(ui, overall)
        ui.note(capital(overall.detail()))
        return
    ui.note("No match yet", "ink")
    if facts is not None:
        note_with_help(context, _expected_text(facts), facts.tone, facts.topics)
        return
    about = session.obstacle or "Match finds a flow from the source to the target"
    _draw_obstacle(ui, session, about)


def _draw_obstacle(ui: Ui, session: Session, about: str) -> None:
    ui.note(sentence(about), "failure" if session.work.blocking_problem else "muted")


def _expected_text(facts: Facts) -> str:
    """Return the expected outcome of a match in one line; the tab Functions shows its reason."""
    is_impossible = facts.outcome is Outcome.IMPOSSIBLE
    return _IMPOSSIBLE_NOTE if is_impossible else sentence(facts.headline)


def _draw_result(context: Context, result: abfm.Match, facts: Facts) -> None:
    ui, session = context.ui, context.session
    tone = "muted" if session.outdated else facts.tone
    tip = "" if facts.short_headline == facts.headline else capital(facts.headline)
    ui.note(capital(facts.short_headline), tone, ui.room_before_help)
    ui.tip(tip)
    draw_help(context, *facts.topics, name=OUTCOME)
    runs = session.editor.draft.runs  # the plot shows the last one
    steps = runs[-1].iterations if runs else len(result.energy_history) - 1
    if steps:  # their number follows on the same line if it fits
        text = counted(steps, "iteration")
        end = imgui.GetCursorPosX() + imgui.GetContentRegionAvail()[0]
        start = end - ui.text_width(text) - ui.px(2)
        if imgui.GetWindowPos()[0] + start > imgui.GetItemRectMax()[0] + ui.px(8):
            imgui.SameLine(start)
            ui.note(text)
    if not session.outdated:
        ui.note(sentence(facts.reason), "ink")
        if facts.other_warnings:
            _draw_warnings(context, facts)
    else:
        ui.note("Functions or parameters have changed since this match.", "ink")
        if (expected := session.work.expected_facts) is not None:
            ui.note(_expected_text(expected), expected.tone)
    _draw_remedies(ui, session, result, facts)
    if numbers := verdict_words.numbers_text(result):
        if math.isfinite(of_map := facts.number("map_residual")):
            numbers += f"; complete map {share(of_map)}"
        topics = ["residual", "flow-line residual", "area change"]
        if result.problem.is_of_landmarks:
            topics = ["landmark error", "folded faces"]
        note_with_help(context, numbers, "muted", topics, name="Explain residuals")


def _draw_warnings(context: Context, facts: Facts) -> None:
    first, *others = map(sentence, facts.other_warnings)
    topics = [topic for topic in facts.topics if topic in [*WarningTopic]] or facts.topics
    note_with_help(context, first, "warning", topics, name="Explain warnings")
    for warning in others:
        context.ui.note(warning, "warning")


def _draw_compared(context: Context, compared: Comparison) -> None:
    ui = context.ui
    found, number = compared.population, compared.subject
    verdict = found.verdicts[number] or "failed"
    is_good = Outcome(verdict).is_good and bool(found.fits[number])
    outlier = [] if found.fits[number] else [str(Outcome.OUTLIER)]
    text, topics = ", ".join([f"{compared.name}: {verdict}", *outlier]), [*outlier, verdict]
    note_with_help(context, text, "good" if is_good else "failure", topics)
    if found.reasons[number]:
        ui.note(sentence(found.reasons[number]), "ink")
    about = "Shown on the template. Press Registration in the table to see the flow."
    ui.note(about)


def _draw_remedies(ui: Ui, session: Session, result: abfm.Match, facts: Facts) -> None:
    if session.outdated:
        if session.obstacle:
            _draw_obstacle(ui, session, session.obstacle)
        return
    verdict = result.verdict
    # if the complete map is the cause, no other flow helps
    offered = verdict.remedies if facts.outcome is verdict.kind else ()
    # the primary button continues
    remedies = [each for each in offered if each.parameters or not each.starts_from_field]
    with ui.group("verdict"):
        for number, remedy in enumerate(remedies):
            if number:
                ui.same_line_if_fits(remedy.label, is_button=True)
            if ui.button(remedy.label, verdict_words.remedy_tooltip(remedy)):
                session.remedy(remedy)
        if distorts := _distorts(facts):
            if remedies:
                ui.same_line_if_fits(LIMIT, is_button=True)
            draw_limit(ui, session, primary=True)
    has_button, advice = bool(remedies) or distorts, facts.advice
    if advice and (verdict.kind is Outcome.IMPOSSIBLE or not has_button):
        ui.note(f"Advice: {advice}.")


def _distorts(facts: Facts) -> bool:
    """Return whether a result is good, but changes areas so much that a bound is recommended."""
    log2 = facts.numbers.get("log2_area_95")
    return facts.outcome.is_good and log2 is not None and log2 > abfm.matching.LOG2_AREA_GOOD

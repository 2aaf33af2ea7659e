"""Plot of the intervals of a sequence: residuals of both checks, or speeds."""

from __future__ import annotations

import numpy as np
import polyscope.imgui as imgui
import polyscope.implot as implot

import abfm
from abfm.outcome import worse_residual
from abfm.types import BoolArray, FloatArray
from abfm.wording import share
from abfm_viewer.document.frame_sequence import FrameSequence
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import draw_help
from abfm_viewer.widgets import plots

_EMPTY_NOTE = (
    "During a run this plot shows the speed in each interval. After it, the plot shows the "
    "residuals of the discrete flow and along flow lines."
)
_VIEWS = {
    "residual": "Residual of each interval, by the discrete flow and along flow lines.",
    "speed": "Root mean square speed in the mesh's unit per second, or per frame without times. "
    "Shaded: slow (stable) or fast (transient).",
}
_DOT_SIZE = 2.6
_DOTS_MAX = 60  # longer sequences are drawn without dots


def draw(context: Context) -> None:
    ui, session, document = context.ui, context.session, context.document(SequenceDocument)
    sequence, result = document.sequence, document.result
    is_live = session.sequence_match.found_count(document) > 0
    if result is None and not is_live:
        ui.note(_EMPTY_NOTE)
        return
    views = [*_VIEWS]
    shows_speed = document.view.speeds or result is None or is_live
    with ui.disabled(result is None or is_live):
        chosen = ui.radio(views, views[shows_speed], [*_VIEWS.values()])
    draw_help(context, "intervals", "motion share", "uncertainty")
    if chosen != views[shows_speed]:
        session.editor.set_view(f"plot {chosen}", speeds=chosen == "speed")
    if result is None or is_live or shows_speed:
        _speeds(context, sequence)
    else:
        _residuals(context, sequence, result)


def unconfirmed(result: abfm.Sequence) -> BoolArray:
    """Return a mask (T - 1,) of the intervals that are solved, but whose match is not confirmed."""
    good = [verdict.kind.is_good for verdict in result.verdicts]
    found: BoolArray = result.solved & ~np.array(good)
    return found


def _speeds(context: Context, sequence: FrameSequence) -> None:
    ui, document = context.ui, context.document(SequenceDocument)
    speeds = context.session.sequence_match.speeds(document)
    episodes = context.shown.tracks.episodes()
    colors = {"stable": (*ui.colors.flow[:3], 0.18), "transient": (*ui.colors.marker[:3], 0.18)}
    legend = {f"speed, in {sequence.unit_of_speed}": ui.colors.flow}
    plots.legend(ui, legend | (colors if episodes else {}))
    with plots.plot(ui, "interval plot") as is_drawn:
        if not is_drawn:
            return
        plots.set_up_linear(_across(sequence), (document.start, document.end), "speed", speeds)
        for episode in episodes:
            plots.span(episode.start, episode.end, colors[episode.kind])
        _present(context, sequence)
        plots.line("##speed", speeds, ui.colors.flow, ui.px(2), sequence.middles)
        if len(sequence) <= _DOTS_MAX:
            ink = ui.colors.flow
            plots.dots("##speeds", (sequence.middles, speeds), ui.px(_DOT_SIZE), (ink, ink))
        _clicks(context, sequence, speeds)


def _residuals(context: Context, sequence: FrameSequence, result: abfm.Sequence) -> None:
    ui, document = context.ui, context.session.document
    unsolved = ~result.solved
    by_flow = np.where(unsolved, np.nan, result.residual)
    by_lines = np.where(unsolved, np.nan, result.verified_residual)
    warned = unconfirmed(result)
    legend = {"residual": ui.colors.flow, "along flow lines": ui.colors.lines}
    plots.legend(ui, legend | ({"not confirmed": ui.colors.failure} if warned.any() else {}))
    with plots.plot(ui, "interval plot") as is_drawn:
        if not is_drawn:
            return
        plots.set_up(_across(sequence), (document.start, document.end), (by_flow, by_lines))
        _present(context, sequence)
        for name, values, ink in (
            ("along flow lines", by_lines, ui.colors.lines),
            ("residual", by_flow, ui.colors.flow),
        ):
            plots.line(f"##{name}", values, ink, ui.px(1.8), sequence.middles)
            if len(sequence) <= _DOTS_MAX:
                dots = sequence.middles, values
                plots.dots(f"##dots {name}", dots, ui.px(_DOT_SIZE), (ink, ink))
        if warned.any():
            failure, worse = ui.colors.failure, worse_residual(by_flow, by_lines)
            at = sequence.middles[warned], worse[warned]
            plots.dots("##unconfirmed", at, ui.px(1.7 * _DOT_SIZE), (failure, failure))
        _clicks(context, sequence, by_flow)


def _across(sequence: FrameSequence) -> str:
    return f"time, {sequence.unit}" if sequence.unit else "frame"


def _present(context: Context, sequence: FrameSequence) -> None:
    ui, time = context.ui, context.session.document.time
    now = sequence.interval(time)
    ends = float(sequence.times[now]), float(sequence.times[now + 1])
    plots.span(*ends, (*ui.colors.accent[:3], 0.2))
    plots.vertical_lines("##time", [time], ui.colors.accent, ui.px(1.5))


def _clicks(context: Context, sequence: FrameSequence, values: FloatArray) -> None:
    """Show the interval on which the user clicks.

    Scripts click on ``interval 0``, ``interval 1``, ...
    """
    ui, session = context.ui, context.session
    known = values[np.isfinite(values)]
    level = float(np.median(known)) if len(known) else 1.0
    for number, middle in enumerate(sequence.middles.tolist()):
        x, y = implot.PlotToPixels(middle, level)
        if np.isfinite(x + y):
            ui.record.add(f"interval {number}", "marker", (x, y, x, y), True)
    if not plots.is_under_mouse():
        return
    at = sequence.interval(float(implot.GetPlotMousePos()[0]))
    plots.tooltip(ui, _tooltip_text(context, sequence, at))
    if imgui.IsMouseClicked(0) and ui.record.enabled:
        session.set_time(float(sequence.middles[at]))


def _tooltip_text(context: Context, sequence: FrameSequence, at: int) -> str:
    session, document = context.session, context.document(SequenceDocument)
    lines = [f"{sequence.frame_label(at)} to {sequence.frame_label(at + 1)}"]
    speed = session.sequence_match.speeds(document)[at]
    result = document.result
    if np.isfinite(speed):
        lines.append(f"speed {speed:.3g}, in {sequence.unit_of_speed}")
    if result is not None and result.solved[at]:
        residual, by_lines = float(result.residual[at]), float(result.verified_residual[at])
        along_lines = f", along flow lines {share(by_lines)}" if np.isfinite(by_lines) else ""
        lines += [f"residual {share(residual)}{along_lines}", result.verdicts[at].kind]
        motion = share(float(result.motion_shares[at]))
        lines.append(f"between the frames, {motion} is shown as motion and the rest as a blend")
    return "\n".join(lines)

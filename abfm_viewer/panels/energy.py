"""Plot of residuals: by iteration, or by the area change of each step of a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polyscope.implot as implot

import abfm
from abfm.wording import share
from abfm_viewer.document.document import RunRecord
from abfm_viewer.document.verdict_words import LONG_RANGE
from abfm_viewer.panels import trade_off
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import draw_help
from abfm_viewer.session.session import Session
from abfm_viewer.widgets import plots
from abfm_viewer.widgets.toolkit import Ui

_AXIS_ITERATIONS_MIN = 10
_NO_RUN = (
    "During a run this plot shows the residual of each iteration. After it, the plot shows the "
    "residual and the area change of each step."
)
_VIEWS = {
    "iterations": "Residual after each iteration.",
    "trade-off": "Residual of each step against the area change of its map.",
}
_MARKS = "Lines: start of a stage (grey), of a finer mesh (wide), or of a changed problem (green)."


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    runs, live = session.editor.draft.runs, session.matching.record
    run, path = live or (runs[-1] if runs else None), trade_off.path_of(session)
    name = "trade_off_live" if session.solver.running else "trade_off"
    has_path = sum(map(math.isfinite, (step.log2_area for step in path))) > 1
    views = [*_VIEWS]
    view = views[has_path and getattr(session.view, name)]
    with ui.disabled(not has_path):
        new = ui.radio(views, view, [*_VIEWS.values()])
    if new != view:
        session.editor.set_view(f"plot the {new}", "", **{name: new == "trade-off"})
    ui.same_line_if_fits("Export CSV...", is_button=True)
    result = session.result
    if view == "trade-off":
        tip = "Write the steps of the continuation to a table. Available after the run."
        title, file, is_enabled = "Export the path", "path.csv", not session.solver.running
        topics = "trade-off", "area change"
    else:
        tip = "Write the total energy, smoothness and closeness of each iteration to a table."
        title, file, is_enabled = "Export the energy", "energy.csv", run is not None
        topics = "iterations", "energy"

    def export(path: Path) -> None:
        """Write the steps or energies that were plotted when the user pressed the button."""
        with session.notices.showing_errors():
            if view == "trade-off":
                abfm.loading.task_of(result).tables["path"].write(path, result)
            elif run is not None:
                abfm.io.export_energy_csv(path, run.energies, run.stages)
            session.notices.show(f"wrote {path}")

    if ui.button("Export CSV...", tip, enabled=is_enabled):
        context.dialogs.save(title, (".csv",), file, export)
    draw_help(context, *topics)
    if view == "trade-off":
        trade_off.draw(context, path)
    else:
        _iterations(ui, session, run, runs if live else runs[:-1])


def _iterations(
    ui: Ui, session: Session, run: RunRecord | None, previous: Sequence[RunRecord]
) -> None:
    tip = "Show the residuals of earlier runs as faint curves."
    shown = ui.checkbox("previous runs", session.view.previous_runs, tip)
    step = f"{'show' if shown else 'hide'} previous runs"
    session.editor.set_view(step, previous_runs=shown)
    ui.same_line_if_fits("Clear")
    tip = "Remove all runs before this one."
    if ui.button("Clear##Clear previous", tip, enabled=bool(previous)):
        latest = () if session.matching.record else session.editor.draft.runs[-1:]
        session.editor.change("clear previous runs", runs=latest)
    if run is None:
        ui.note(_NO_RUN)
        return
    stages, meshes = starts(run)
    legend = (("grey: stage", stages), ("wide: mesh", meshes), ("green: restart", run.restarts))
    marks = ", ".join(mark for mark, places in legend if places)
    ui.note("; ".join(filter(None, [run.label, marks])))
    ui.tip(_MARKS if marks else "")
    _plot(ui, run, previous if session.view.previous_runs else ())


def _plot(ui: Ui, run: RunRecord, previous: Sequence[RunRecord]) -> None:
    (stages, meshes), residuals, best = starts(run), run.residual_curve, run.best_residuals
    # curves of result files are only estimates, whose scale cannot be compared
    before = [earlier.best_residuals for earlier in previous if len(earlier.residuals)]
    last = max(*map(len, [residuals, *before]), _AXIS_ITERATIONS_MIN + 1) - 1
    with plots.plot(ui, "energy plot") as is_drawn:
        if not is_drawn:
            return
        plots.set_up("iteration", (0, last), [residuals, *before])
        muted, flow = ui.colors.muted[:3], ui.colors.flow
        for number, earlier in enumerate(before):
            plots.line(f"##previous {number}", earlier, (*muted, 0.45), ui.px(1))
        plots.vertical_lines("##stages", stages, (*muted, 0.5), ui.px(1))
        plots.vertical_lines("##meshes", meshes, (*muted, 0.7), ui.px(2.5))
        plots.vertical_lines("##restarts", run.restarts, ui.colors.marker, ui.px(1.5))
        plots.line("##each", residuals, (*flow[:3], 0.5), ui.px(1))
        plots.line("##least", best, flow, ui.px(2))
        if plots.is_under_mouse():
            _draw_tooltip(ui, run)


def _draw_tooltip(ui: Ui, run: RunRecord) -> None:
    at = int(np.clip(round(implot.GetPlotMousePos()[0]), 0, len(run.stages) - 1))
    plots.vertical_lines("##here", [at], ui.colors.ink, ui.px(1))
    best, residual = run.best_residuals[at], run.residual_curve[at]
    restart = ", restarted here" if at in run.restarts else ""
    lines = [f"iteration {at}{restart}", stage_text(run, at), f"residual {share(residual)}"]
    if share(best) != share(residual):
        lines[-1] += f", best so far {share(best)}"
    lines += [f"{name} {values[at]:.4g}" for name, values in run.curves.items()]
    lines += [f"σ {sigma:.3g}" for sigma in run.sigmas[at : at + 1]]
    plots.tooltip(ui, "\n".join(lines))


def stage_text(run: RunRecord, at: int) -> str:
    """Return the stage of an iteration as text: ``mesh of 2,500 vertices, stage 2``."""
    parts = [f"stage {run.stages[at] + 1}"]
    if run.has_mesh_sizes:
        search = [LONG_RANGE] if run.reaches[at] else []
        parts = [f"mesh of {run.vertices[at]:,} vertices", *search, *parts]
    return ", ".join(parts)


def starts(run: RunRecord) -> tuple[list[int], list[int]]:
    """Return the iterations at which stages began, and those at which finer meshes began.

    Restarts of the solver are omitted. An iteration that began both is only in the second list.
    """
    finer, other = np.diff(run.vertices) > 0, np.diff(run.stages) != 0
    places: list[list[int]] = [(np.flatnonzero(new) + 1).tolist() for new in (other, finer)]
    stages, meshes = ([at for at in found if at not in run.restarts] for found in places)
    return [at for at in stages if at not in meshes], meshes

"""Plot of residuals: by iteration, or by the area change of each step of a path."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import polyscope.implot as implot

import abfm
from abfm.wording import share
from abfm_viewer.document.document import RunRecord
from abfm_viewer.document.verdict_words import LONG_RANGE
from abfm_viewer.files.names import suggested_name
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


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    runs, live = session.editor.draft.runs, session.matching.record
    run, path = live or (runs[-1] if runs else None), trade_off.path_of(session)
    name = "trade_off_live" if session.solver.running else "trade_off"
    has_path = sum(map(math.isfinite, (step.log2_area for step in path))) > 1
    views = [*_VIEWS]
    view = views[has_path and getattr(session.view, name)]
    with ui.disabled(not has_path, "The match has fewer than two steps to compare."):
        new = ui.radio(views, view, [*_VIEWS.values()])
    if new != view:
        session.editor.set_view(f"plot the {new}", "", **{name: new == "trade-off"})
    ui.same_line_if_fits("Export CSV...", is_button=True)
    result = session.result
    if view == "trade-off":
        tip = "Write the steps of the continuation to a table. Available after the run."
        title, kind, is_enabled = "Export the path", "path", not session.solver.running
        topics = "trade-off", "area change"
    else:
        tip = "Write the total energy, smoothness and closeness of each iteration to a table."
        title, kind, is_enabled = "Export the energy", "energy", run is not None
        topics = "iterations", "energy"

    def export(path: Path) -> None:
        """Write the steps or energies that were plotted when the user pressed the button."""
        with session.notices.showing_errors():
            if view == "trade-off":
                abfm.loading.task_of(result).tables["path"].write(path, result)
            elif run is not None:
                abfm.io.export_energy_csv(path, run.energies, run.stages)
            session.notices.show(f"wrote {path}")

    with ui.disabled(not is_enabled, "There is no finished run."):
        if ui.button("Export CSV...", tip):
            name = suggested_name(session.document, kind, ".csv")
            context.dialogs.save(title, (".csv",), name, export)
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
    with ui.disabled(not previous, "There are no earlier runs."):
        if ui.button("Clear##Clear previous", tip):
            latest = () if session.matching.record else session.editor.draft.runs[-1:]
            session.editor.change("clear previous runs", runs=latest)
    if run is None:
        ui.note(_NO_RUN)
        return
    mesh = session.surface().mesh
    _plot(ui, run, previous if session.view.previous_runs else (), len(mesh.vertices))


def _plot(ui: Ui, run: RunRecord, previous: Sequence[RunRecord], vertices: int) -> None:
    residuals, best, names = run.residual_curve, run.best_residuals, sections(run, vertices)
    stages, meshes = ([at for at in found if at not in names] for found in starts(run))
    # curves of result files are only estimates, whose scale cannot be compared
    before = [earlier.best_residuals for earlier in previous if len(earlier.residuals)]
    last = max(*map(len, [residuals, *before]), _AXIS_ITERATIONS_MIN + 1) - 1
    muted, flow = ui.colors.muted[:3], ui.colors.flow
    lines = {
        "each iteration": plots.Line((*flow[:3], 0.6), ui.px(1)),
        "best so far": plots.Line(flow, ui.px(2.5)),
        "previous runs": plots.Line((*muted, 0.45), ui.px(1)),
        "stage": plots.Line((*muted, 0.5), ui.px(1), True),
        "finer mesh": plots.Line((*muted, 0.7), ui.px(2.5), True),
    }
    absent = {"previous runs": before, "stage": stages, "finer mesh": meshes}
    plots.legend(ui, {name: line for name, line in lines.items() if absent.get(name, True)})
    each, least, earlier, of_stage, of_mesh = lines.values()
    with plots.plot(ui, "energy plot") as is_drawn:
        if not is_drawn:
            return
        plots.set_up("iteration", (0, last), [residuals, *before], len(names) > 1)
        for number, curve in enumerate(before):
            plots.line(f"##previous {number}", curve, *earlier[:2])
        plots.vertical_lines("##stages", stages, *of_stage[:2])
        plots.vertical_lines("##meshes", meshes, *of_mesh[:2])
        if len(names) > 1:
            plots.sections(ui, names, len(residuals) - 1)
        for start, end in pairwise([*names, len(residuals)]):
            place = np.arange(start, end, dtype=np.float64)
            plots.line(f"##each {start}", residuals[start:end], *each[:2], place)
            plots.line(f"##best {start}", best[start:end], *least[:2], place)
        if len(residuals) and plots.is_under_mouse():
            _draw_tooltip(ui, run, names)


def _draw_tooltip(ui: Ui, run: RunRecord, names: Mapping[int, str]) -> None:
    at = int(np.clip(round(implot.GetPlotMousePos()[0]), 0, len(run.stages) - 1))
    plots.vertical_lines("##here", [at], ui.colors.ink, ui.px(1))
    best, residual = run.best_residuals[at], run.residual_curve[at]
    start = max(each for each in names if each <= at)
    of_section = f" ({names[start]}, iteration {at - start})" if len(names) > 1 else ""
    lines = [f"iteration {at}{of_section}", stage_text(run, at), f"residual {share(residual)}"]
    if share(best) != share(residual):
        lines[-1] += f", best so far {share(best)}"
    lines += [f"{name} {values[at]:.4g}" for name, values in run.curves.items()]
    lines += [f"σ {sigma:.3g}" for sigma in run.sigmas[at : at + 1]]
    lines += [f"run: {run.label}"] if run.label else []
    plots.tooltip(ui, "\n".join(lines))


def stage_text(run: RunRecord, at: int) -> str:
    """Return the stage of an iteration as text: ``mesh of 2,500 vertices, stage 2``."""
    parts = [f"stage {run.stages[at] + 1}"]
    if run.has_mesh_sizes:
        search = [LONG_RANGE] if run.reaches[at] else []
        parts = [f"mesh of {run.vertices[at]:,} vertices", *search, *parts]
    return ", ".join(parts)


def sections(run: RunRecord, vertices: int) -> dict[int, str]:
    """Return the names of the sections of a run by their first iterations.

    A section begins with a changed problem, a new attempt of the solver, or a refinement of the
    mesh, which has a number of ``vertices``.
    """
    count, restarts = len(run.stages), [at for at in run.restarts if at < len(run.stages)]
    attempts = run.attempts if len(run.attempts) else np.ones(count, dtype=np.int64)
    sizes = np.maximum(run.vertices if run.has_mesh_sizes else np.zeros(count), vertices)
    has_attempts = bool((attempts > 1).any())
    found = {0: "attempt 1" if has_attempts else "match"}
    is_start = (np.diff(attempts) != 0) | (np.diff(sizes) != 0)
    for at in sorted({*restarts, *(np.flatnonzero(is_start) + 1).tolist()}):
        refined = "refined" if sizes[at] > sizes[at - 1] else ""
        found[at] = "changed" if at in restarts else refined or f"attempt {attempts[at]}"
    return found


def starts(run: RunRecord) -> tuple[list[int], list[int]]:
    """Return the iterations at which stages began, and those at which finer meshes began.

    An iteration that began both is only in the second list.
    """
    finer, other = np.diff(run.vertices) > 0, np.diff(run.stages) != 0
    stages, meshes = ((np.flatnonzero(new) + 1).tolist() for new in (other, finer))
    return [at for at in stages if at not in meshes], meshes

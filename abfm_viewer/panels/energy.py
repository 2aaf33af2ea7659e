"""The energy over the iterations: of the run that goes on or ended last, and of those before."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import polyscope.imgui as imgui
import polyscope.implot as implot

import abfm
from abfm import AbfmError
from abfm.types import FloatArray
from abfm_viewer.appearance.theme import Color
from abfm_viewer.document.document import Run
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import plot
from abfm_viewer.widgets.toolkit import Ui

_LOWEST, _HIGHEST = 150, 240
_SHORTEST_AXIS = 10  # iterations
_NO_RUN = (
    "Appears here while the solver runs: the energy of each iteration, with its smoothness and "
    "closeness terms."
)
_PLOT = (
    implot.ImPlotFlags_NoTitle
    | implot.ImPlotFlags_NoMenus
    | implot.ImPlotFlags_NoLegend  # one of ours goes on in a second line where the panel is narrow
    | implot.ImPlotFlags_NoBoxSelect
    | implot.ImPlotFlags_NoMouseText
    | implot.ImPlotFlags_NoInputs  # the wheel scrolls the panel
)


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    runs, live = session.document.runs, session.solver.run
    run = live or (runs[-1] if runs else None)
    previous = runs if live else runs[:-1]
    tip = "Draw the total energy of earlier runs as faint curves."
    shown = ui.checkbox("previous runs", session.view.previous_runs, tip)
    step = f"{'show' if shown else 'hide'} previous runs"
    session.editor.set_view(step, previous_runs=shown)
    ui.beside_if_fits("Clear")
    tip = "Forget the runs before this one."
    if ui.button("Clear##Clear previous", tip, enabled=bool(previous)):
        session.editor.change("clear previous runs", runs=() if live else runs[-1:])
    ui.beside_if_fits("Export CSV...")
    tip = "Write the three energies of each iteration of this run to a table."
    if ui.button("Export CSV...", tip, enabled=run is not None) and run is not None:
        write = partial(_export, session, run)
        context.dialogs.save("Export the energy", (".csv",), "energy.csv", write)
    if run is None:
        ui.note(_NO_RUN)
        return
    stages, meshes = starts(run)
    told = (("grey: stage", stages), ("wide: mesh", meshes), ("green: restart", run.restarts))
    marks = ", ".join(mark for mark, places in told if places)
    about = "Lines: where a stage began (grey), a finer mesh (wide), or a changed problem (green)."
    ui.line("; ".join(filter(None, [run.label, marks])), tip=about if marks else "")
    _plot(ui, run, previous if session.view.previous_runs else ())


def _export(session: Session, run: Run, path: Path) -> None:
    """Write the run that was shown when the button was pressed."""
    try:
        abfm.io.export_energy_csv(path, run.energies, run.stages)
    except AbfmError as error:
        session.notices.say(str(error), is_error=True)
    else:
        session.notices.say(f"wrote {path}")


def _plot(ui: Ui, run: Run, previous: Sequence[Run]) -> None:
    curves = {name: _positive(values) for name, values in run.curves.items()}
    totals = [_positive(earlier.energies[:, 0]) for earlier in previous]
    last = max(len(run.stages), *(len(total) for total in totals), _SHORTEST_AXIS + 1) - 1
    values = np.concatenate([*curves.values(), *totals])
    values = values[np.isfinite(values)]
    low, high = (0.7 * values.min(), 1.5 * values.max()) if len(values) else (0.1, 10.0)
    terms = cycle((ui.colors.closeness, ui.colors.good, ui.colors.accent))
    colors = (ui.colors.muted, ui.colors.smoothness, *islice(terms, len(curves) - 2))
    inks = dict(zip(curves, colors, strict=True))
    _legend(ui, inks)
    room, (stages, meshes) = imgui.GetContentRegionAvail()[1], starts(run)
    height = min(max(room, ui.px(_LOWEST)), ui.px(_HIGHEST))  # as high as fits
    with plot(ui, "energy plot", height, _PLOT) as is_drawn:
        if not is_drawn:
            return
        implot.SetupAxis(implot.ImAxis_X1, "", implot.ImPlotAxisFlags_None)
        implot.SetupAxis(implot.ImAxis_Y1, "", implot.ImPlotAxisFlags_None)
        implot.SetupAxisScale(implot.ImAxis_Y1, implot.ImPlotScale_Log10)
        implot.SetupAxisFormat(implot.ImAxis_Y1, "%g")
        implot.SetupAxesLimits(0, last, float(low), float(high), implot.ImPlotCond_Always)
        for number, total in enumerate(totals):
            _line(f"##previous {number}", total, (*ui.colors.muted[:3], 0.45), ui.px(1))
        _marks("##stages", stages, (*ui.colors.muted[:3], 0.7), ui.px(1))
        _marks("##meshes", meshes, (*ui.colors.muted[:3], 0.9), ui.px(2.5))
        _marks("##restarts", run.restarts, ui.colors.marker, ui.px(1.5))
        for name, curve in curves.items():
            _line(name, curve, inks[name], ui.px(1.8))
        _hover(ui, run)


def _legend(ui: Ui, colors: Mapping[str, Color]) -> None:
    side, (_, spacing) = 0.6 * imgui.GetTextLineHeight(), imgui.GetStyle().ItemSpacing
    for number, (name, color) in enumerate(colors.items()):
        if number:
            ui.beside_if_fits(name)
        left, top = imgui.GetCursorScreenPos()
        top += (imgui.GetTextLineHeight() - side) / 2
        corners, ink = ((left, top), (left + side, top + side)), imgui.GetColorU32(color)
        imgui.GetWindowDrawList().AddRectFilled(*corners, ink)
        imgui.Dummy((side, side))
        ui.beside(spacing)
        ui.line(name, "ink")


def _hover(ui: Ui, run: Run) -> None:
    left, top = implot.GetPlotPos()
    width, height = implot.GetPlotSize()
    x, y = imgui.GetMousePos()
    if not (imgui.IsWindowHovered() and left <= x <= left + width and top <= y <= top + height):
        return
    mouse_x, _ = implot.GetPlotMousePos()
    at = int(np.clip(round(mouse_x), 0, len(run.stages) - 1))
    _marks("##here", [at], ui.colors.ink, ui.px(1))
    lines = [f"iteration {at}{', restarted here' if at in run.restarts else ''}", course(run, at)]
    lines += [f"{name} {values[at]:.4g}" for name, values in run.curves.items()]
    imgui.SetTooltip("\n".join(lines))


def _line(label: str, values: FloatArray, color: Color, weight: float) -> None:
    implot.SetNextLineStyle(color, weight)
    implot.PlotLine(label, np.arange(float(len(values))), values)


def _marks(label: str, iterations: Sequence[int], color: Color, weight: float) -> None:
    if iterations:
        implot.SetNextLineStyle(color, weight)
        implot.PlotInfLines(label, np.array(iterations, dtype=np.float64))


def course(run: Run, at: int) -> str:
    """Return an iteration's ``mesh of 2,500 vertices, reach 0.5, stage 2``."""
    parts = [f"stage {run.stages[at] + 1}"]
    if run.has_course:
        reach = [f"reach {run.reaches[at]:g}"] if run.reaches[at] else []
        parts = [f"mesh of {run.vertices[at]:,} vertices", *reach, *parts]
    return ", ".join(parts)


def starts(run: Run) -> tuple[list[int], list[int]]:
    """Return where another stage began on the same mesh, and where a finer mesh; not restarts."""
    finer, other = np.diff(run.vertices) > 0, np.diff(run.stages) != 0
    places: list[list[int]] = [(np.flatnonzero(new) + 1).tolist() for new in (other, finer)]
    stages, meshes = ([at for at in found if at not in run.restarts] for found in places)
    return [at for at in stages if at not in meshes], meshes


def _positive(values: FloatArray) -> FloatArray:
    """Return values for a logarithmic axis: what it cannot show is left out."""
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)

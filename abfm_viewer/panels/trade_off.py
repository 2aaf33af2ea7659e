"""The trade-off plot: residuals of the steps of a match against the area changes of their maps."""

from typing import TypeAlias

import numpy as np
import polyscope.imgui as imgui
import polyscope.implot as implot

import abfm
from abfm import ParameterError
from abfm.types import FloatArray
from abfm.wording import factor, share
from abfm_viewer.appearance.axes import factor_ticks, readable_ticks
from abfm_viewer.appearance.theme import Color
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session
from abfm_viewer.widgets import plots
from abfm_viewer.widgets.toolkit import Ui, finite

Steps: TypeAlias = "tuple[abfm.matching.PathStep, ...]"

_SOLVER_CHOICE = "solver's choice"
_STEP = (
    "Step of the continuation to show, save and export; a click on the curve, Up and Down also "
    "choose it. Its residual is recomputed without the clusters of vertices that speed up the "
    "solver on thin triangles, so it may be larger."
)
_BOUND_TIP = (
    "Largest area and shape change, |log2 J| and |log2 R|, on 99% of the faces: 1 allows factors "
    "from 1/2 to 2. For two surfaces it includes the initial map."
)
LIMIT = "Limit distortion"
_STOP = "Stop limiting"
_LIMIT_TIP = "Find the field of smallest residual within the bound."
_AXIS_WIDTH_MIN = 0.01  # width of the axis of areas, in doublings
_LABEL_GAP = 10
_AXIS_WIDTH = 80  # of the vertical axis with its labels, in pixels at a scale of 1
_PRESENT_RESIDUAL = "present iteration"
_OTHER_ATTEMPTS = "other attempts"
# markers of the residual are drawn over the larger ones of the residual along flow lines
_FLOW_LINE_MARKER_SIZE = 5.5
_RESIDUAL_MARKER_SIZE = 3.5
_SHOWN_MARKER_GROWTH = 2.5
_CLICK_DISTANCE = 16  # maximum distance of a click from a marker, in pixels at a scale of 1


def path_of(session: Session) -> Steps:
    """Return the steps that the current run has finished, or without a run, those of the result."""
    if session.solver.running:
        snapshot = session.matching.snapshot
        return snapshot.iteration.path if snapshot else ()
    return session.result.path if session.result else ()


def draw(context: Context, path: Steps) -> None:
    ui, session = context.ui, context.session
    is_live = session.solver.running
    shown = len(path) - 1 if is_live else session.steps.shown
    chosen = None if is_live else session.steps.solver_step
    _choice(ui, session, path, shown, chosen)
    if not is_live:
        _bound(ui, session)
    _curve(ui, session, path, shown, chosen)


def _choice(ui: Ui, session: Session, path: Steps, shown: int, chosen: int | None) -> None:
    names = [f"step {n + 1} of {len(path)}: σ {step.sigma:.3g}" for n, step in enumerate(path)]
    tips = {name: _step_text(path, n, chosen) for n, name in enumerate(names)}
    room, (padding, _) = imgui.GetContentRegionAvail()[0], imgui.GetStyle().FramePadding
    button = ui.text_width(_SOLVER_CHOICE) + 2 * padding + imgui.GetStyle().ItemSpacing[0]
    with ui.disabled(session.solver.running):
        width = room - button if 2 * button < room else room
        new = ui.combo("##step", names[shown], tips, _STEP, width)
        if new != names[shown]:
            session.show_step(names.index(new))
        ui.same_line_if_fits(_SOLVER_CHOICE, is_button=True)
        tip = "Return to the step that the solver chose."
        if ui.button(_SOLVER_CHOICE, tip, enabled=chosen != shown) and chosen is not None:
            session.show_step(chosen)


def _bound(ui: Ui, session: Session) -> None:
    bound = session.bound
    caption = ui.text_width("distortion") + imgui.GetStyle().ItemSpacing[0]
    width = min(ui.px(90), imgui.GetContentRegionAvail()[0] - caption)
    typed = ui.text("distortion", f"{bound.maximum:g}", _BOUND_TIP, width=width)
    if typed is not None:
        with ui.refusals.refusing("distortion"):
            if (number := finite(typed)) is None or not number > 0:
                raise ParameterError(
                    f"{typed} is not a bound of distortion; expected a number above 0, such as 1"
                )
            bound.maximum = number
    ui.same_line_if_fits(LIMIT, is_button=True)
    draw_limit(ui, session)
    ui.refusal("distortion")


def draw_limit(ui: Ui, session: Session, primary: bool = False) -> None:
    bound = session.bound
    label = _STOP if bound.busy else LIMIT
    tip = f"{_LIMIT_TIP} The bound is {bound.maximum:g}."
    if ui.button(label, tip, enabled=session.result is not None, primary=primary):
        bound.stop() if bound.busy else session.limit_distortion()


def _curve(ui: Ui, session: Session, path: Steps, shown: int, chosen: int | None) -> None:
    areas = np.array([step.log2_area for step in path])
    by_flow = plots.positive(np.array([step.residual for step in path]))
    by_lines = plots.positive(np.array([step.verified_residual for step in path]))
    snapshot = session.matching.snapshot if session.solver.running else None
    now = np.array([snapshot.iteration.residual] if snapshot else [])
    others = [
        np.array([[step.log2_area, step.residual] for step in steps]).T
        for steps in (snapshot.others.values() if snapshot else ())
        if steps
    ]
    known = np.concatenate([areas, *(each[0] for each in others)])
    low, high = area_range(known)
    muted = plots.Line((*ui.colors.muted[:3], 0.8), ui.px(1.2))
    choice = plots.Line(ui.colors.good, ui.px(1.5), True)
    present = plots.Line((*ui.colors.flow[:3], 0.5), ui.px(1))
    marks: dict[str, Color | plots.Line] = {
        "residual": ui.colors.flow,
        "along flow lines": ui.colors.lines,
    }
    marks |= {_PRESENT_RESIDUAL: present} if len(now) else {}
    marks |= {_OTHER_ATTEMPTS: muted} if others else {}
    plots.legend(ui, marks | ({} if chosen is None else {_SOLVER_CHOICE: choice}))
    width = imgui.GetContentRegionAvail()[0]
    with plots.plot(ui, "trade-off plot") as is_drawn:
        if not is_drawn:
            return
        ends = low - 0.05 * (high - low), high + 0.05 * (high - low)
        curves = (by_flow, by_lines, now, *(each[1] for each in others))
        plots.set_up("areas change by a factor of", ends, curves)
        ticks, factors = factor_ticks(low, high)
        unit = (width - ui.px(_AXIS_WIDTH)) / (ends[1] - ends[0])
        widths = [ui.text_width(label) + ui.px(_LABEL_GAP) for label in factors]
        kept = readable_ticks([unit * tick for tick in ticks], widths)
        shown_ticks = np.array([ticks[number] for number in kept])
        implot.SetupAxisTicks(implot.ImAxis_X1, shown_ticks, [factors[number] for number in kept])
        if chosen is not None:
            plots.vertical_lines("##chosen", [float(areas[chosen])], *choice[:2])
        if len(now):
            plots.horizontal_line("##now", float(now[0]), *present[:2])
        for number, (across, up) in enumerate(others):
            plots.line(f"##other {number}", up, *muted[:2], across)
            plots.dots(f"##others {number}", (across, up), ui.px(2), (muted.color, muted.color))
        for name, residuals, ink, size in (
            ("along flow lines", by_lines, ui.colors.lines, _FLOW_LINE_MARKER_SIZE),
            ("residual", by_flow, ui.colors.flow, _RESIDUAL_MARKER_SIZE),
        ):
            plots.line(name, residuals, ink, ui.px(1.8), areas)
            plots.dots(f"##{name}", (areas, residuals), ui.px(size), (ink, ink))
            if chosen is not None:
                at = slice(shown, shown + 1)
                place, edge = (areas[at], residuals[at]), ui.colors.ink
                growth = _SHOWN_MARKER_GROWTH
                plots.dots(f"##{name} shown", place, ui.px(size + growth), (ink, edge))
        _clicks(ui, session, path, (areas, by_flow, by_lines), chosen)


def area_range(log2_areas: FloatArray) -> tuple[float, float]:
    """Return the ends of the axis of area changes, which begins at 0 unless all are large."""
    known = log2_areas[np.isfinite(log2_areas)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    low = low if low > high / 2 else 0.0
    return low, max(high, low + _AXIS_WIDTH_MIN)


def _clicks(
    ui: Ui, session: Session, path: Steps, curve: tuple[FloatArray, ...], chosen: int | None
) -> None:
    """Show the tooltip of the marker below the mouse, and the step on which the user clicks.

    Scripts click on ``step 1``, ``step 2``, ...
    """
    areas, *residuals = curve
    places = np.array(
        [
            [implot.PlotToPixels(float(x), float(y)) for x, y in zip(areas, values, strict=True)]
            for values in residuals
        ]
    )
    for n, (x, y) in enumerate(places[0]):
        if np.isfinite(x + y):
            ui.record.add(f"step {n + 1}", "marker", (x, y, x, y), not session.solver.running)
    distances = np.linalg.norm(places - imgui.GetMousePos(), axis=2)
    distances = np.nan_to_num(distances, nan=np.inf).min(axis=0)
    nearest = int(np.argmin(distances))
    if not (plots.is_under_mouse() and distances[nearest] <= ui.px(_CLICK_DISTANCE)):
        return
    plots.tooltip(ui, _step_text(path, nearest, chosen))
    if imgui.IsMouseClicked(0) and ui.record.enabled and not session.solver.running:
        session.show_step(nearest)


def _step_text(path: Steps, number: int, chosen: int | None) -> str:
    step = path[number]
    parameters = f"σ {step.sigma:.3g}, α {step.alpha:.3g}, reach {step.reach:.3g}"
    if (faces := step.velocity.shape[1]) > path[0].velocity.shape[1]:
        parameters += f", on a finer mesh of {faces:,} faces"
    residuals = f"residual {share(step.residual)}"
    if step.verified_residual == step.verified_residual:
        residuals += f", along flow lines {share(step.verified_residual)}"
    lines = [
        f"step {number + 1} of {len(path)}{f', the {_SOLVER_CHOICE}' if number == chosen else ''}",
        parameters,
        residuals,
    ]
    if step.log2_area == step.log2_area:
        lines += [
            f"area change: factor {factor(step.log2_area)}, mean |log2 J| {step.log2_area:.3g}",
            f"shape change: factor {factor(step.log2_shape)}, mean |log2 R| {step.log2_shape:.3g}",
        ]
    if step.folded == step.folded:
        lines.append(f"{100 * step.folded:.2g}% of the faces folded")
    if step.score == step.score:
        lines.append(f"held-out residual + 0.25 |log2 J|: {step.score:.4f}; the smallest is chosen")
    return "\n".join(lines)

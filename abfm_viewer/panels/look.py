"""The tab Look: settings of the view, and facts in numbers."""

import numpy as np

from abfm.pages.sequence_motion import CRITICAL_COLORS
from abfm.wording import counted, sentence
from abfm_viewer.document.document import CLICK_TOOLS, FIELD_PARTS, TRANSFERRED_COLORINGS, Coloring
from abfm_viewer.document.verdict_words import refinement_text
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import draw_help
from abfm_viewer.session.session_files import LABELS
from abfm_viewer.shown.quantities import FIELD_COLORINGS
from abfm_viewer.widgets import plots
from abfm_viewer.widgets.toolkit import HELP_TEXT
from abfm_viewer.widgets.widget_record import Range

_COLORINGS: dict[Coloring, str] = {
    "function": "The advected function.",
    "speed": "Speed of the field, in sqrt(area) per time. Sequences use the unit of the mesh.",
    "divergence": "Divergence of the field: positive where the flow spreads.",
    "curl": "Curl of the field: where the flow rotates, and in which direction.",
    "coordinates": "Coordinates as red, green and blue, advected by the flow.",
    "checker": "Checkerboard, advected by the flow.",
    "labels": "Labels of the source's surface, such as brain regions, advected by the flow.",
    "area distortion": "Area change of each face: enlarged (red) or reduced (blue).",
    "conformal distortion": "Ratio of the largest to the smallest stretch of each face.",
}
_OF_FIELD = (*FIELD_COLORINGS, "area distortion", "conformal distortion")
_RANGES = {
    "robust": "From the 2nd to the 98th percentile, if extreme values stretch the range. The "
    "colour bar has an arrow where values lie beyond.",
    "full": "From the smallest to the largest value.",
}
_MAPS: tuple[Coloring, ...] = (*TRANSFERRED_COLORINGS, "area distortion", "conformal distortion")
_LABELS = "Open labels..."
_PART = (
    "The complete field, or a part of its Helmholtz-Hodge decomposition. Also the smoothest "
    "commuting field (takes seconds), or the source's gradient, pushed forward by the flow."
)
_ARROWS = "Show the field as arrows on the advected surface."
_STREAKS = "Show the field as streaks (line integral convolution). They take seconds to compute."
_TRACKS = (
    "Paths of the fields' sources, sinks, spirals and saddles over time. Balls show their "
    "positions at the shown time."
)
_LINKS = "Lines from points of A to their images on B at the shown time."
_FADE = "Reduce the contrast of the streaks where the field is slow."
_UNCERTAIN = (
    "Make arrows, streaks and colours of the field faint where the data do not determine the "
    "motion: where functions are flat, and along contours. Smoothness determines it there."
)
_CLICKS = (
    "A click does nothing.",
    "A click places a landmark.",
    "A click draws the flow line through the point.",
    "A click follows the point over time.",
)
_COMPARISON_TIPS = {
    "linear blend": "Add a surface with (1 - t/τ) source + t/τ target, without motion.",
    "optimal transport": "Add a surface with the Wasserstein interpolation of source and target.",
    "error": "Add a surface with |target - advected|, with a separate colour range.",
}


def _switch(context: Context, label: str, name: str, step: str, tip: str) -> None:
    value = context.ui.checkbox(label, getattr(context.session.view, name), tip)
    context.session.editor.set_view(step, "", **{name: value})


def draw_coloring(context: Context) -> None:
    ui, set_view = context.ui, context.session.editor.set_view
    now, is_full = context.session.view.coloring, context.session.view.full_range
    tip = f"Colours of the advected surface. {_COLORINGS[now]}"
    chosen = ui.combo("colour by", now, _COLORINGS, tip)
    kind = "full" if is_full else "robust"
    kind = ui.combo("range", kind, _RANGES, f"Range of the colours. {_RANGES[kind]}")
    set_view(f"colour by {chosen}", coloring=chosen)
    set_view("change the range", full_range=kind == "full")
    if chosen == "labels":
        _draw_labels(context, opens=chosen != now)


def draw_links(context: Context) -> None:
    _switch(context, "lines from A to B", "links", "toggle lines", _LINKS)


def _draw_labels(context: Context, opens: bool) -> None:
    """Draw the labels, and a button that opens a file; ``opens`` presses it if there are none."""
    ui, labels = context.ui, context.session.document.labels
    tip = "Open labels of the source's surface: .label.gii, .annot, .dlabel.nii, or integers."
    if ui.button(_LABELS, tip) or (opens and labels is None):
        context.dialogs.open("Open labels", LABELS, context.files.open_labels)
    if labels is not None:
        ui.same_line_if_fits(labels.file)
        named = sum(map(bool, labels.names)) or len(labels.keys)
        ui.line(
            f"{labels.file}, {counted(named, 'label')}", tip=", ".join(filter(None, labels.names))
        )


def draw_field(context: Context) -> None:
    ui, view, set_view = context.ui, context.session.view, context.session.editor.set_view
    ui.heading("flow")
    part = ui.combo("part", view.part, FIELD_PARTS, _PART)
    set_view(f"show the {part} field", part=part)
    _switch(context, "arrows", "arrows", "toggle arrows", _ARROWS)
    obstacle = _streaks_obstacle(context)
    is_shown = view.arrows or (view.streaks and not obstacle) or view.coloring in FIELD_COLORINGS
    with ui.disabled(not is_shown, "Tick arrows or streaks first, or colour by speed."):
        ui.same_line_if_fits("fade uncertain motion")
        _switch(context, "fade uncertain motion", "fade_uncertain", "toggle fading", _UNCERTAIN)
        draw_help(context, "uncertainty")
    with ui.disabled(not view.arrows, "Tick arrows first."):
        tip = "Largest length as a fraction of sqrt(area). Dense arrows are shorter, so that they "
        tip += "do not overlap."
        length = ui.number("length", view.arrow_length, Range(0.01, 0.4), tip)
        if length is not None and length > 0:
            set_view(
                "change the length of arrows", "length", arrow_length=min(max(length, 0.001), 10.0)
            )
        tip = "Density of arrows on the screen. A surface that is drawn larger has more arrows."
        density = ui.bounded("density", view.arrow_density, Range(0, 1), tip, (0.0, 1.0))
        set_view("change the density of arrows", "density", arrow_density=density)
    with ui.disabled(obstacle != "", obstacle):
        _switch(context, "streaks", "streaks", "toggle streaks", _STREAKS)
    with ui.disabled(not view.streaks or obstacle != "", obstacle or "Tick streaks first."):
        ui.same_line_if_fits("fade with speed")
        _switch(context, "fade with speed", "fade", "toggle fading", _FADE)
        ui.same_line_if_fits("animate")
        tip = "Move the streaks along the field, here and in movies."
        _switch(context, "animate", "animate", "toggle animation", tip)


def _streaks_obstacle(context: Context) -> str:
    """Return the reason why streaks cannot be drawn now; empty if there is none."""
    if context.session.view.coloring in TRANSFERRED_COLORINGS:
        return "Streaks are not drawn over coordinates, a checkerboard or labels."
    return "Streaks are drawn after the match." if context.session.matching.running else ""


def draw_tracks(context: Context) -> None:
    ui, session = context.ui, context.session
    with ui.disabled(session.document.result is None, "Match the frames first."):
        _switch(context, "tracks", "tracks", "toggle tracks", _TRACKS)
    draw_help(context, "tracks", "uncertainty")
    if found := context.shown.tracks.counts():
        named = {counted(count, kind): CRITICAL_COLORS[kind] for kind, count in found.items()}
        plots.legend(ui, named)


def draw_clicks(context: Context) -> None:
    ui, document, editor = context.ui, context.session.document, context.session.editor
    ui.heading("a click on a surface")
    tools = dict(zip(CLICK_TOOLS, _CLICKS, strict=True))
    if not document.has_sides and document.view.tool != "landmark":
        tools.pop("landmark")
    tool = ui.radio([*tools], document.view.tool, [*tools.values()])
    editor.set_view("choose what a click does", tool=tool)
    for name, what in (("lines", "flow lines"), ("points", "followed points")):
        ui.same_line_if_fits(f"Clear {name}", is_button=True)
        with ui.disabled(not getattr(document, name), f"There are no {what}."):
            if ui.button(f"Clear {name}", f"Remove all {what}."):
                editor.change(f"clear {name}", "", **{name: ()})


def draw_compare(context: Context) -> None:
    context.ui.heading("compare with")
    for number, (label, tip) in enumerate(_COMPARISON_TIPS.items()):
        if number:
            context.ui.same_line_if_fits(label)
        _switch(context, label, label.split()[-1], "compare", tip)


def draw_numbers(context: Context) -> None:
    context.ui.heading("in numbers", buttons=[HELP_TEXT])
    topics = "residual", "speed", "area change", "colour range", "folded faces", "round trip"
    draw_help(context, *topics, name="Explain numbers", after_heading=True)
    for draw_some in (_range, _error, _field, _map, _points):
        draw_some(context)


def _range(context: Context) -> None:
    """Report the range of the colours if values lie beyond it."""
    is_of_field = context.session.view.coloring in _OF_FIELD
    colors = context.shown.ranges.get("field" if is_of_field else "function")
    if colors is not None and any(colors.clipped):
        low, high = colors.full
        context.ui.note(
            f"Colours from {colors.low:.4g} to {colors.high:.4g}, values from {low:.4g} to "
            f"{high:.4g}."
        )


def _error(context: Context) -> None:
    ui, session, transport = context.ui, context.session, context.shown.mass_transport
    if session.view.transport and transport.error:
        ui.note(f"No optimal transport: {transport.error}.", "failure")
    elif session.view.transport and transport.note:
        ui.note(f"{transport.note.capitalize()}.")
    target, advected = session.work.flow_values("target"), context.shown.flow.advected()
    if target is not None and advected is not None and session.document.has_one_field:
        difference = np.abs(target - advected)
        worst = int(np.argmax(difference))
        ui.note(
            f"Error: at most {difference[worst]:.4g} (vertex "
            f"{session.surface('error').mesh.vertex_ids[worst]}), mean "
            f"{float(difference.mean()):.4g}."
        )
    result = None if session.outdated or session.solver.running else session.result
    if result is not None and result.refined:
        ui.note(f"{sentence(refinement_text(result))} View > Finer mesh shows it there.")


def _field(context: Context) -> None:
    ui, quantities = context.ui, context.shown.quantities
    if context.shown.flow.state is None:
        ui.note("The field is shown during and after a match.")
    field = quantities.field()
    if context.session.view.part == "commuting" and quantities.is_computing_field:
        ui.note("The commuting field is being computed.")
    elif field is not None:
        speed, unit = field.relative_speed()
        ui.note(f"Largest speed {float(speed.max()):.4g}, in {unit}.")
        if field.note:
            ui.note(field.note)
        if shares := [f"{name} {100 * share:.1f}%" for name, share in field.shares.items()]:
            ui.note(f"Shares of the field's squared norm: {', '.join(shares)}.")
    if quantities.error:
        ui.note(quantities.error, "failure")


def _map(context: Context) -> None:
    ui, view, quantities = context.ui, context.session.view, context.shown.quantities
    quality = quantities.map_quality() if view.coloring in _MAPS else None
    if quality is None:
        return
    found, back = quality.distortion, quality.round_trip
    area, shape = found.log2_area, found.log2_shape
    ui.note(
        f"Area change |log2 J|: mean {area.mean:.3f}, 95% of the area below {area.p95:.3f}. "
        f"Shape change |log2 R|: mean {shape.mean:.3f}, 95% of the area below {shape.p95:.3f}. "
        f"Folded faces: {found.folded}. "
        f"Round-trip error: median {back.median:.2g} edges, 95% of vertices below {back.p95:.2g}."
    )
    if quality.warning:
        ui.note(f"Warning: {quality.warning}.", "failure")


def _points(context: Context) -> None:
    document, mesh = context.session.document, context.session.surface().mesh
    if document.lines:
        context.ui.note(f"{counted(len(document.lines), 'flow line')}.")
    for point, path in zip(document.points, context.shown.quantities.paths(), strict=False):
        x, y, z = path.at(context.shown.quantities.path_time)
        corner = mesh.faces[point.face][int(np.argmax(point.barycentric))]
        where = f"({x:.4g}, {y:.4g}, {z:.4g})"
        context.ui.note(f"The point from vertex {mesh.vertex_ids[corner]} is at {where}.")

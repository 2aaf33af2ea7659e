"""The tab Look: what the surfaces show, and what can be said of it in numbers."""

import numpy as np

import abfm
from abfm.pages.film_motion import CRITICAL_COLORS
from abfm.wording import counted, sentence
from abfm_viewer.document.document import CLICK_TOOLS, FIELD_PARTS, TRANSFERRED_COLORINGS, Coloring
from abfm_viewer.document.verdict_words import refinement_text
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session_files import LABELS
from abfm_viewer.widgets import plots
from abfm_viewer.widgets.widget_record import Range

_COLORINGS: dict[Coloring, str] = {
    "function": "The advected function itself.",
    "speed": "How fast the field is; of a film in the mesh's unit, else in sqrt(area), per time.",
    "divergence": "Where the flow spreads (positive) and where it gathers.",
    "curl": "Where the flow turns, and which way.",
    "coordinates": "The coordinates as red, green and blue, carried by the flow.",
    "checker": "A checkerboard, carried by the flow.",
    "labels": "Labels of the source's surface, such as regions of a brain, carried by the flow.",
    "area distortion": "How much larger (red) or smaller (blue) the map makes each face.",
    "conformal distortion": "How much the map stretches each face in one direction more than in "
    "the other.",
}
_MAPS: tuple[Coloring, ...] = (*TRANSFERRED_COLORINGS, "area distortion", "conformal distortion")
_LABELS = "Open labels..."
_PART = (
    "The whole field, or a part of its Helmholtz-Hodge decomposition: without curl, without "
    "divergence, or both. Or the smoothest field that commutes with it (seconds), or the "
    "source's gradient, carried along its flow."
)
_ARROWS = "The field as arrows on the advected surface."
_STREAKS = "Lines all over the surface: line integral convolution, seconds after a match."
_TRACKS = (
    "Where the fields' sources, sinks, spirals and saddles go over the surface in time; balls show "
    "where they are at the shown time."
)
_LINKS = "From points of A to where they are on B at the shown time."
_FADE = "Less contrast of the streaks where the field is slower."
_CLICKS = (
    "Nothing.",
    "A landmark.",
    "A flow line through the point.",
    "Follow where the point goes over time.",
)
_COMPARISON_TIPS = {
    "linear blend": "A surface with (1 - t/τ) source + t/τ target: nothing moves, it only fades.",
    "optimal transport": "A surface with the Wasserstein interpolation: the mass takes the "
    "shortest ways.",
    "error": "A surface with |target - advected|, on a range of its own.",
}


def _switch(context: Context, label: str, name: str, step: str, tip: str) -> None:
    value = context.ui.checkbox(label, getattr(context.session.view, name), tip)
    context.session.editor.set_view(step, "", **{name: value})


def draw_coloring(context: Context) -> None:
    now = context.session.view.coloring
    tip = f"What the advected surface shows. {_COLORINGS[now]}"
    chosen = context.ui.combo("color by", now, _COLORINGS, tip)
    context.session.editor.set_view(f"color by {chosen}", coloring=chosen)
    if chosen == "labels":
        _draw_labels(context, opens=chosen != now)


def draw_links(context: Context) -> None:
    _switch(context, "lines from A to B", "links", "switch lines", _LINKS)


def _draw_labels(context: Context, opens: bool) -> None:
    """Draw which labels there are, and what opens others: at once where there are none."""
    ui, labels = context.ui, context.session.document.labels
    tip = "Labels of the source's surface: .label.gii, .annot, .dlabel.nii, or whole numbers."
    if ui.button(_LABELS, tip) or (opens and labels is None):
        context.dialogs.open("Open labels", LABELS, context.files.open_labels)
    if labels is not None:
        ui.beside_if_fits(labels.file)
        named = sum(map(bool, labels.names)) or len(labels.keys)
        ui.line(
            f"{labels.file}, {counted(named, 'label')}", tip=", ".join(filter(None, labels.names))
        )


def draw_field(context: Context) -> None:
    ui, view, set_view = context.ui, context.session.view, context.session.editor.set_view
    ui.heading("flow")
    part = ui.combo("part", view.part, FIELD_PARTS, _PART)
    set_view(f"show the {part} field", part=part)
    _switch(context, "arrows", "arrows", "switch arrows", _ARROWS)
    with ui.disabled(not view.arrows):
        tip = "Of the longest, at most, as a fraction of sqrt(area). None is so long that it would "
        tip += "lie over another one: where arrows are dense they are shorter."
        length = ui.number("length", view.arrow_length, Range(0.01, 0.4), tip)
        if length is not None and length > 0:
            set_view("arrows' length", "length", arrow_length=min(max(length, 0.001), 10.0))
        tip = "How near to each other arrows are, in pixels: there are more on a larger surface."
        density = ui.bounded("density", view.arrow_density, Range(0, 1), tip, (0.0, 1.0))
        set_view("arrows' density", "density", arrow_density=density)
    _switch(context, "streaks", "streaks", "switch streaks", _STREAKS)
    with ui.disabled(not view.streaks):
        ui.beside_if_fits("fade with speed")
        _switch(context, "fade with speed", "fade", "switch fading", _FADE)
        ui.beside_if_fits("animate")
        tip = "Streaks move along the field, here and in movies."
        _switch(context, "animate", "animate", "switch animation", tip)


def draw_tracks(context: Context) -> None:
    """Draw the switch of a film's tracks, and what their colours mean."""
    ui, session = context.ui, context.session
    with ui.disabled(session.document.result is None):
        _switch(context, "tracks", "tracks", "switch tracks", _TRACKS)
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
    if ui.button("Clear lines", "Remove all flow lines.", enabled=bool(document.lines)):
        editor.change("clear lines", lines=())
    ui.beside_if_fits("Clear points")
    if ui.button("Clear points", "Follow no points any more.", enabled=bool(document.points)):
        editor.change("clear points", points=())


def draw_compare(context: Context) -> None:
    context.ui.heading("compare with")
    for number, (label, tip) in enumerate(_COMPARISON_TIPS.items()):
        if number:
            context.ui.beside_if_fits(label)
        _switch(context, label, label.split()[-1], "compare", tip)


def draw_numbers(context: Context) -> None:
    context.ui.heading("in numbers")
    for draw_some in (_error, _field, _map, _points):
        draw_some(context)


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
            f"At time {session.document.time:.4g} the error is at most {difference[worst]:.4g}, at "
            f"vertex {session.surface('error').mesh.vertex_ids[worst]}; on average "
            f"{float(difference.mean()):.4g}."
        )
    if session.result is not None and not (session.outdated or session.solver.running):
        if not session.result.problem.is_of_landmarks:
            numbers = abfm.matching.residual_text(session.result)
            ui.note(f"Mismatch at τ: {numbers}; relative to the target in L2.")
        if session.result.refined:
            ui.note(f"{sentence(refinement_text(session.result))} View, Finer mesh shows it there.")


def _field(context: Context) -> None:
    ui, quantities = context.ui, context.shown.quantities
    if context.shown.flow.state is None:
        ui.note("There is a field after, and during, a match.")
    field = quantities.field()
    if context.session.view.part == "commuting" and quantities.is_computing_field:
        ui.note("The field that commutes is being computed.")
    elif field is not None:
        speed, unit = field.relative_speed()
        ui.note(f"Largest speed {float(speed.max()):.4g}, in {unit}.")
        if field.note:
            ui.note(field.note)
        if shares := [f"{name} {100 * share:.1f}%" for name, share in field.shares.items()]:
            ui.note(f"Of the squared norm: {', '.join(shares)}.")
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
        f"|log2| of areas' factors: mean {area.mean:.3f}, 95% below {area.p95:.3f}; of stretches' "
        f"ratios: {shape.mean:.3f}, {shape.p95:.3f}. Folded faces: {found.folded}. There and back: "
        f"{back.median:.2g} edges, 95% below {back.p95:.2g}."
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
        context.ui.note(f"From vertex {mesh.vertex_ids[corner]} to {where}.")

"""What is shown, in numbers: field, map, followed points, error; last, as there may be more."""

import numpy as np

from abfm_viewer.document.document import Coloring
from abfm_viewer.document.verdict_words import counted, numbers
from abfm_viewer.panels.context import Context

_DISTORTIONS: tuple[Coloring, ...] = ("area distortion", "conformal distortion")
_MAPS: tuple[Coloring, ...] = ("coordinates", "checker", *_DISTORTIONS)


def draw(context: Context) -> None:
    context.ui.heading("in numbers")
    for draw_some in (_error, _field, _map, _points):
        draw_some(context)


def _error(context: Context) -> None:
    ui, session = context.ui, context.session
    if session.view.transport and context.shown.mass_transport.error:
        ui.note(f"No optimal transport: {context.shown.mass_transport.error}.", "failure")
    elif session.view.transport and context.shown.mass_transport.note:
        ui.note(f"{context.shown.mass_transport.note.capitalize()}.")
    target, advected = session.values("target"), context.shown.flow.advected()
    if target is not None and advected is not None:
        difference = np.abs(target - advected)
        mesh, worst = session.surface("error").mesh, int(np.argmax(difference))
        ui.note(
            f"At time {session.time:.4g} the error is at most {difference[worst]:.4g}, at vertex "
            f"{mesh.vertex_ids[worst]}; on average {float(difference.mean()):.4g}."
        )
    if session.result is not None and not (session.outdated or session.solver.running):
        ui.note(f"Mismatch at τ: {numbers(session.result)}; relative to the target in L2.")


def _field(context: Context) -> None:
    ui, quantities = context.ui, context.shown.quantities
    if context.shown.flow.state is None:
        ui.note("There is a field after, and during, a match.")
    field = quantities.field()
    if context.session.view.part == "commuting" and quantities.finding:
        ui.note("The field that commutes is being computed.")
    elif field is not None:
        speed, unit = field.relative_speed()
        ui.note(f"Largest speed {float(speed.max()):.4g}, in {unit}.")
        if field.note:
            ui.note(field.note)
        shares = [f"{name} {100 * share:.1f}%" for name, share in field.shares.items()]
        if shares:
            ui.note(f"Of the squared norm: {', '.join(shares)}.")
    if quantities.error:
        ui.note(quantities.error, "failure")


def _map(context: Context) -> None:
    ui, view, quantities = context.ui, context.session.view, context.shown.quantities
    if view.coloring in _DISTORTIONS and (found := quantities.distortion()) is not None:
        low, area, high = np.percentile(found.area, (5, 50, 95))
        # between infinite ones there is nothing
        most = np.percentile(found.conformal, 95, method="nearest")
        ui.note(
            f"Area's factor: median {area:.3f}, 5 to 95% {low:.3f} to {high:.3f}. Stretches' "
            "ratio: median "
            f"{np.median(found.conformal):.3f}, 95% below {most:.3f}. Flipped faces: "
            f"{int(found.flipped.sum())}."
        )
    if view.coloring in _MAPS:
        quality = quantities.map_quality()
        if quality is not None and quality.warning:
            ui.note(f"Warning: {quality.warning}.", "failure")


def _points(context: Context) -> None:
    ui, session = context.ui, context.session
    mesh = session.surface().mesh
    if session.document.lines:
        ui.note(f"{counted(len(session.document.lines), 'flow line')}.")
    for point, path in zip(session.document.points, context.shown.quantities.paths(), strict=False):
        x, y, z = path.at(context.shown.flow.time)
        corner = mesh.faces[point.face][int(np.argmax(point.barycentric))]
        ui.note(f"From vertex {mesh.vertex_ids[corner]} to ({x:.4g}, {y:.4g}, {z:.4g}).")

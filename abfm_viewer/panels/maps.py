"""The flow as a map: what it does to coordinates, textures and points."""

import numpy as np

from abfm_viewer.document.document import Coloring
from abfm_viewer.panels.context import Context

_COLORINGS: dict[Coloring, str] = {
    "function": "The advected function itself.",
    "coordinates": "The coordinates as red, green and blue, carried by the flow.",
    "checker": "A checkerboard, carried by the flow.",
    "area distortion": "How much larger (red) or smaller (blue) the map makes each face.",
    "conformal distortion": "How much the map stretches each face in one direction more than in the other.",
}


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    view, quantities = session.view, context.shown.quantities
    chosen = ui.radio(tuple(_COLORINGS), view.coloring, tuple(_COLORINGS.values()))
    session.set_view(f"color by {chosen}", coloring=chosen)
    if view.coloring in ("area distortion", "conformal distortion") and (found := quantities.distortion()) is not None:
        low, area, high = np.percentile(found.area, (5, 50, 95))
        most = np.percentile(found.conformal, 95, method="nearest")  # between infinite ones there is nothing
        ui.note(
            f"Area's factor: median {area:.3f}, 5 to 95% {low:.3f} to {high:.3f}. Stretches' ratio: median "
            f"{np.median(found.conformal):.3f}, 95% below {most:.3f}. Flipped faces: {int(found.flipped.sum())}."
        )
    if view.coloring != "function" and view.coloring in _COLORINGS:
        quality = quantities.map_quality()
        if quality is not None and quality.warning:
            ui.note(f"Warning: {quality.warning}.", "failure")
    follows = view.tool == "follow a point"
    follow = ui.checkbox("follow clicked points", follows, "A click on a surface marks a point, which then moves.")
    if follow != follows:
        session.set_view("choose what a click does", tool="follow a point" if follow else "nothing")
    for point, path in zip(session.document.points, quantities.paths(), strict=False):
        x, y, z = path.at(context.shown.flow.time)
        corner = session.mesh.faces[point.face][int(np.argmax(point.barycentric))]
        ui.note(f"from vertex {session.mesh.vertex_ids[corner]} to ({x:.4g}, {y:.4g}, {z:.4g})")
    if session.document.points and ui.button("Clear points", "Follow no points any more."):
        session.change("clear points", points=())
    if quantities.error:
        ui.note(quantities.error, "failure")

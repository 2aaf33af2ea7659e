"""The mesh: what it is, and what was done to it."""

from abfm_viewer.panels.context import Context

_OPEN = "Open mesh..."


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    mesh = session.surface().mesh
    if ui.button(_OPEN, "Choose a mesh file. It can also be dropped on the window."):
        context.open_mesh()
    loops = mesh.boundary_loop_count
    boundary = "" if mesh.is_closed else f", {loops} boundary loop{'s' if loops > 1 else ''}"
    topology = f"{'closed, ' if mesh.is_closed else ''}genus {mesh.genus}{boundary}"
    scale = mesh.length_scale
    area = f"Area {scale**2:.4g}; widths are fractions of its root, {scale:.4g}."
    ui.beside()
    ui.align()
    ui.line(session.document.name, "ink", area)
    ui.line(f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces; {topology}", tip=area)
    for message in mesh.messages:
        ui.note(message)

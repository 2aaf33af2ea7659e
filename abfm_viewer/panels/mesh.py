"""The mesh: what it is, and what was done to it."""

from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    mesh = session.mesh
    ui.note(session.document.name, "ink")
    loops = mesh.boundary_loop_count
    boundary = "" if mesh.is_closed else f", {loops} boundary loop{'s' if loops > 1 else ''}"
    topology = f"{'closed, ' if mesh.is_closed else ''}genus {mesh.genus}{boundary}"
    ui.note(f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces; {topology}")
    ui.note(f"area {mesh.length_scale**2:.4g}; widths are fractions of its root, {mesh.length_scale:.4g}")
    for message in mesh.messages:
        ui.note(message)
    if ui.button("Open mesh...", "Choose a mesh file. It can also be dropped on the window."):
        context.open_mesh()

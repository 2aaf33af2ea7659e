"""The mesh: what it is, and what was done to it."""

from __future__ import annotations

from abfm.mesh import TriangleMesh
from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    """Draw facts and messages."""
    ui, session = context.ui, context.session
    mesh = session.mesh
    ui.note(session.document.name, "ink")
    ui.note(f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces; {_topology(mesh)}")
    ui.note(f"area {mesh.length_scale**2:.4g}; widths are fractions of its root, {mesh.length_scale:.4g}")
    for message in mesh.messages:
        ui.note(message)
    if ui.button("Open mesh...", "Choose a mesh file. It can also be dropped on the window."):
        context.open_mesh()


def _topology(mesh: TriangleMesh) -> str:
    if mesh.is_closed:
        return f"closed, genus {mesh.genus}"
    loops = mesh.boundary_loop_count
    return f"genus {mesh.genus}, {loops} boundary loop{'s' if loops > 1 else ''}"

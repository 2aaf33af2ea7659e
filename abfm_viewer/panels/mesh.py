"""The mesh: what it is, and what was done to it."""

from __future__ import annotations

from abfm.mesh import TriangleMesh
from abfm_viewer.session import Session
from abfm_viewer.ui import Ui


def draw(ui: Ui, session: Session) -> None:
    """Draw facts and messages."""
    mesh = session.mesh
    ui.note(f"{session.document.name}: {len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces", "ink")
    ui.note(_topology(mesh))
    ui.note(f"area {mesh.length_scale**2:.6g}; the solver takes its square root, {mesh.length_scale:.6g}, as 1")
    for message in mesh.messages:
        ui.note(message)


def _topology(mesh: TriangleMesh) -> str:
    if mesh.is_closed:
        return f"closed, genus {mesh.genus}"
    loops = mesh.boundary_loop_count
    return f"genus {mesh.genus}, with {loops} boundary loop{'s' if loops > 1 else ''}"

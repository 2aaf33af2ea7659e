"""The status line."""

from __future__ import annotations

import polyscope.imgui as imgui

from abfm_viewer.session import Session
from abfm_viewer.ui import Rect, Ui


def draw(ui: Ui, session: Session, rect: Rect) -> None:
    """Draw what goes on, the mesh's size and frames per second."""
    with ui.window("status line", rect):
        mesh = session.mesh
        state = session.notice.text or session.busy or session.solver.reason
        ui.note(f"{state}  {len(mesh.vertices):,} vertices  {imgui.GetIO().Framerate:.0f} fps")

"""Rings around the Gaussians that the mouse would move."""

from __future__ import annotations

import numpy as np
import polyscope.imgui as imgui

from abfm import FunctionError, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Side
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.scene import Scene
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_RADIUS, _LINE = 9.0, 2.0
_SIDES: tuple[Side, ...] = ("source", "target")


class BumpMarkers:
    """Draws them while Shift is held over the surfaces, and where a side has several Gaussians."""

    def __init__(self) -> None:
        self._known: dict[Side, tuple[TriangleMesh, str, int, int, FloatArray]] = {}

    def draw(self, ui: Ui, session: Session, scene: Scene, rect: Rect) -> None:
        """Draw a ring on each side that has one to draw."""
        if session.values("source") is None and session.values("target") is None:
            return
        x, y = imgui.GetIO().MousePos
        inside = rect[0] <= x < rect[2] and rect[1] <= y < rect[3]
        for side in _SIDES:
            self._draw_side(ui, session, scene, side, imgui.GetIO().KeyShift and inside)

    def _draw_side(self, ui: Ui, session: Session, scene: Scene, side: Side, wanted: bool) -> None:
        from abfm_viewer.document import gaussians as bumps  # not before: it loads what the first frame does without
        from abfm_viewer.session.active_gaussian import active_bump

        bump = active_bump(session, side)
        if bump is None or session.active is None or side not in scene.offsets:
            return
        spec = session.active.spec(side)
        if bumps.is_mapped(spec) or not (wanted or len(bumps.gaussians(spec)) > 1):
            return
        known = self._known.get(side)
        if known is None or known[0] is not session.mesh or known[1:3] != (spec, bump):
            try:
                vertex = int(bumps.gaussians(spec)[bump].sources(session.mesh)[0])
            except FunctionError:  # the panel says so
                return
            self._known[side] = known = (session.mesh, spec, bump, vertex, _normal(session.mesh, vertex))
        place = session.mesh.vertices[known[3]] + scene.offsets[side]
        if _faces_camera(scene.viewport.drawn(place), known[4]):
            x, y, _ = scene.viewport.projected(place)[0]
            canvas = imgui.GetBackgroundDrawList()
            for width, color in ((2 * _LINE, ui.colors.ground), (_LINE, ui.colors.ink)):
                ring = int(imgui.GetColorU32(color))
                canvas.AddCircle((x, y), ui.px(_RADIUS), ring, 0, ui.px(width))


def _normal(mesh: TriangleMesh, vertex: int) -> FloatArray:
    corners = mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]]
    normal: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    return normal


def _faces_camera(place: FloatArray, normal: FloatArray) -> bool:
    view = np.asarray(ps.get_camera_view_matrix())
    seen = view[:3, :3] @ place + view[:3, 3]
    return bool(seen @ (view[:3, :3] @ normal) < 0)

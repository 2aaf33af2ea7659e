"""Rings around the Gaussians that the mouse would move."""

from contextlib import suppress

import numpy as np
import polyscope.imgui as imgui

from abfm import FunctionError
from abfm.types import FloatArray
from abfm_viewer.computing.background import Memo
from abfm_viewer.document import gaussians
from abfm_viewer.document.document import SIDES, Side
from abfm_viewer.scene.scene import Scene
from abfm_viewer.session.active_gaussian import active_gaussian
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

_RADIUS, _LINE = 9.0, 2.0


class GaussianMarkers:
    """Draws them while Shift is held over the surfaces, and where a side has several Gaussians."""

    def __init__(self) -> None:
        self._centres: dict[Side, Memo[tuple[FloatArray, FloatArray] | None]] = {
            side: Memo() for side in SIDES
        }

    def draw(self, ui: Ui, session: Session, scene: Scene, rect: Rect) -> None:
        """Draw a ring on each side that has one to draw."""
        if session.values("source") is None and session.values("target") is None:
            return
        x, y = imgui.GetIO().MousePos
        wanted = imgui.GetIO().KeyShift and rect[0] <= x < rect[2] and rect[1] <= y < rect[3]
        for side in SIDES:
            if side in scene.shown:
                self._draw_side(ui, session, scene, side, wanted)

    def _draw_side(self, ui: Ui, session: Session, scene: Scene, side: Side, wanted: bool) -> None:
        chosen, mesh = active_gaussian(session, side), session.surface(side).mesh
        if chosen is None or session.active is None:
            return
        spec = session.active.spec(side)
        if gaussians.is_mapped(spec) or not (wanted or len(gaussians.gaussians(spec)) > 1):
            return

        def centre() -> tuple[FloatArray, FloatArray] | None:
            """Return a place and a normal; None for a vertex that is not there."""
            with suppress(FunctionError):
                vertex = gaussians.gaussians(spec)[chosen].sources(mesh)[0]
                a, b, c = np.moveaxis(
                    mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]], 1, 0
                )
                return mesh.vertices[vertex], np.cross(b - a, c - a).sum(axis=0)
            return None

        found = self._centres[side].get((mesh, spec, chosen), centre)
        if found is None:
            return
        place, normal = found
        x, y, _ = scene.projected(side, place)[0]
        left, top, right, bottom = scene.view.slots[side].rect
        if scene.view.rotation[2] @ normal > 0 and left <= x <= right and top <= y <= bottom:
            canvas = imgui.GetBackgroundDrawList()
            for width, color in ((2 * _LINE, ui.colors.ground), (_LINE, ui.colors.ink)):
                ring = int(imgui.GetColorU32(color))
                canvas.AddCircle((x, y), ui.px(_RADIUS), ring, 0, ui.px(width))

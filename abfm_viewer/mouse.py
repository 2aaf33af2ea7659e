"""What the mouse does on the surfaces: moving Gaussians, setting their width, starting flow lines."""

from __future__ import annotations

import math

import polyscope.imgui as imgui

from abfm_viewer import bumps
from abfm_viewer.document import Side
from abfm_viewer.opengl import ps
from abfm_viewer.scene import Hit, Scene
from abfm_viewer.session import Session
from abfm_viewer.ui import Rect

_STILL = 4.0  # pixels that a click may move
_WIDTH_PER_NOTCH = 1.12
_NARROWEST, _WIDEST = 0.005, 2.0


class Mouse:
    """Follows the mouse from frame to frame.

    Attributes
    ----------
    dragging : bool
        Whether it holds a Gaussian.
    """

    def __init__(self) -> None:
        self.dragging = False
        self._pressed_at: tuple[float, float] | None = None
        self._held: Side = "source"

    def update(self, session: Session, scene: Scene, rect: Rect, free: bool) -> None:
        """Do what the mouse asks for in this frame; `free` if it may, as when no dialog is open."""
        io = imgui.GetIO()
        x, y = io.MousePos
        inside = rect[0] <= x < rect[2] and rect[1] <= y < rect[3]
        over = free and inside and not io.WantCaptureMouse
        ours = over and io.KeyShift
        ps.set_do_default_mouse_interaction(not (ours or self.dragging) and free)
        if ours or self.dragging:
            imgui.SetMouseCursor(imgui.ImGuiMouseCursor_Hand)
        if ours and imgui.IsMouseClicked(0):
            self._grab(session, scene.pick((x, y)))
        elif self.dragging and imgui.IsMouseDown(0) and tuple(io.MouseDelta) != (0, 0):
            hit = scene.pick((x, y))
            if hit is not None and hit.surface == self._held:
                self._move(session, hit)
        elif ours and io.MouseWheel != 0:
            self._widen(session, scene.pick((x, y)), io.MouseWheel)
        if self.dragging and not imgui.IsMouseDown(0):
            self.dragging = False
            session.history.seal()
        self._click(session, scene, (x, y), over and not io.KeyShift)

    def _grab(self, session: Session, hit: Hit | None) -> None:
        if hit is None or hit.surface not in ("source", "target"):
            if hit is not None:
                session.say("Shift-click on the source or the target moves its Gaussian; this surface has none.")
            return
        self._held = "source" if hit.surface == "source" else "target"
        if self._active(session, self._held) is None:
            session.say(f"the {self._held} has no Gaussian to move: choose the family gaussian, or add one")
            return
        self.dragging = True
        session.history.seal()
        self._move(session, hit)

    def _move(self, session: Session, hit: Hit) -> None:
        bump = self._active(session, self._held)
        if bump is not None and session.active is not None:
            vertex = int(session.mesh.vertex_ids[hit.vertex])
            spec = bumps.changed(session.active.spec(self._held), bump, vertex=vertex)
            session.set_spec(self._held, spec, merge=f"drag {self._held}")

    def _widen(self, session: Session, hit: Hit | None, notches: float) -> None:
        if hit is None or hit.surface not in ("source", "target"):
            return
        side: Side = "source" if hit.surface == "source" else "target"
        bump = self._active(session, side)
        if bump is None or session.active is None:
            session.say(f"the {side} has no Gaussian to widen")
            return
        spec = session.active.spec(side)
        width = bumps.gaussians(spec)[bump].width * math.pow(_WIDTH_PER_NOTCH, notches)
        width = float(f"{min(max(width, _NARROWEST), _WIDEST):.3g}")
        session.set_spec(side, bumps.changed(spec, bump, width=width), merge=f"wheel {side}")

    def _active(self, session: Session, side: Side) -> int | None:
        """Which of a side's Gaussians the mouse moves; None if there are none."""
        if session.active is None:
            return None
        count = len(bumps.gaussians(session.active.spec(side)))
        wanted = session.document.bump if session.document.side == side else 0
        return min(wanted, count - 1) if count else None

    def _click(self, session: Session, scene: Scene, place: tuple[float, float], over: bool) -> None:
        """Start a flow line or follow a point where the left button went down and up in one place."""
        if imgui.IsMouseClicked(0):
            self._pressed_at = place if over and session.view.tool != "nothing" else None
        if imgui.IsMouseReleased(0) and self._pressed_at is not None:
            still = math.dist(place, self._pressed_at) <= _STILL
            self._pressed_at = None
            hit = scene.pick(place) if still else None
            if hit is not None:
                session.add_point("lines" if session.view.tool == "flow line" else "points", hit.point)

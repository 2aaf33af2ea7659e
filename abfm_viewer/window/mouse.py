"""What the mouse does on the surfaces: moving Gaussians, setting their width, placing points."""

import math
import time

import polyscope.imgui as imgui

from abfm_viewer.document.document import SIDES, Side
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.scene import Scene
from abfm_viewer.session import active_gaussian
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.widget_record import Rect

_STILL = 4.0  # pixels that a click may move
_BURST = 0.5  # seconds without a turn of the wheel that end a step of undo


class Mouse:
    """Follows the mouse from frame to frame."""

    def __init__(self) -> None:
        self._held: Side | None = None
        self._wheel_until = 0.0
        self._pressed_at: tuple[float, float] | None = None

    @property
    def dragging(self) -> bool:
        """Whether it moves a Gaussian or sets its width: changes until it lets go are one step of undo."""
        return self._held is not None or time.perf_counter() < self._wheel_until

    def update(self, session: Session, scene: Scene, rect: Rect, free: bool) -> None:
        """Do what the mouse asks for in this frame; `free` if it may, as when no dialog is open."""
        io = imgui.GetIO()
        x, y = io.MousePos
        inside = rect[0] <= x < rect[2] and rect[1] <= y < rect[3]
        over = free and inside and not io.WantCaptureMouse
        if not (free and imgui.IsMouseDown(0)):
            self._held = None
        ours = (over and io.KeyShift) or self._held is not None
        ps.set_do_default_mouse_interaction(not ours)
        if ours:
            imgui.SetMouseCursor(imgui.ImGuiMouseCursor_Hand)
            self._edit_gaussian(session, scene, (x, y))
        self._place_point(session, scene, (x, y), over and not ours)

    def _edit_gaussian(self, session: Session, scene: Scene, place: tuple[float, float]) -> None:
        """Take, move or widen a Gaussian; a pick draws the surfaces again, so not in every frame."""
        io = imgui.GetIO()
        notches = io.MouseWheel or io.MouseWheelH  # with Shift, some systems turn the wheel sideways
        pressed = bool(imgui.IsMouseClicked(0))
        moved = self._held is not None and tuple(io.MouseDelta) != (0, 0)
        if not (pressed or moved or notches):
            return
        if (hit := scene.pick(place)) is None:
            return
        side = next((side for side in SIDES if side == hit.surface), None)
        if side is None:
            if pressed:
                session.say("Shift-click on the source or the target to move its Gaussian; this surface has none")
        elif self._held is None and pressed:
            if reason := active_gaussian.why_fixed(session, side):
                session.say(reason)
                return
            session.history.seal()
            self._held = side
            active_gaussian.move(session, side, hit.vertex, f"drag {side}")
        elif self._held == side and moved:
            active_gaussian.move(session, side, hit.vertex, f"drag {side}")
        elif self._held is None and notches:
            self._wheel_until = time.perf_counter() + _BURST
            active_gaussian.widen(session, side, notches, f"wheel {side}")

    def _place_point(self, session: Session, scene: Scene, place: tuple[float, float], over: bool) -> None:
        """Start a flow line or follow a point where the left button went down and up in one place."""
        if imgui.IsMouseClicked(0):
            places = over and session.view.tool != "nothing" and not imgui.IsMouseDoubleClicked(0)
            self._pressed_at = place if places else None
        if imgui.IsMouseReleased(0) and self._pressed_at is not None:
            still = math.dist(place, self._pressed_at) <= _STILL
            self._pressed_at = None
            hit = scene.pick(place) if still else None
            if hit is not None:
                session.add_point("lines" if session.view.tool == "flow line" else "points", hit.point)

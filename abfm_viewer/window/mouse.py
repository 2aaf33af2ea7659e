"""What the mouse does on the surfaces: turning, moving and zooming them, moving Gaussians, placing points."""

import math
import time

import polyscope.imgui as imgui

from abfm_viewer.document.document import SIDES, Side
from abfm_viewer.scene.scene import Scene
from abfm_viewer.scene.slot_view import Place
from abfm_viewer.session import active_gaussian
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.widget_record import Rect

_STILL = 4.0  # pixels that a click may move
_MOVING = (1, 2)  # buttons: right and middle
_NEARER = 1.15  # by one notch of the wheel
_BURST = 0.5  # seconds without a turn of the wheel that end a step of undo


class Mouse:
    """Follows the mouse from frame to frame; `over` is the surface in whose slot it is, or empty."""

    def __init__(self) -> None:
        self.over = ""
        self._held: Side | None = None
        self._wheel_until = 0.0
        self._pressed_at: Place | None = None
        self._turned: tuple[str, Place] | None = None  # the surface that it turns, and where it was
        self._clicked_twice: Place | None = None  # where, until the button is released
        self._moves = False

    @property
    def dragging(self) -> bool:
        """Whether it moves a Gaussian or sets its width: changes until it lets go are one step of undo."""
        return self._held is not None or time.perf_counter() < self._wheel_until

    def update(self, session: Session, scene: Scene, rect: Rect, free: bool) -> None:
        """Do what the mouse asks for in this frame; `free` if it may, as when no dialog is open."""
        io = imgui.GetIO()
        x, y = place = tuple(io.MousePos)
        inside = rect[0] <= x < rect[2] and rect[1] <= y < rect[3]
        over = free and inside and not io.WantCaptureMouse and bool(scene.names)
        self.over = scene.view.slot_at(place) if over else ""
        if not (free and imgui.IsMouseDown(0)):
            self._held = self._turned = None
        ours = (over and io.KeyShift) or self._held is not None
        if ours:
            imgui.SetMouseCursor(imgui.ImGuiMouseCursor_Hand)
            self._edit_gaussian(session, scene, place)
        elif scene.names:
            self._look(scene, place, over, free)
        self._place_point(session, scene, place, over and not ours)

    def _look(self, scene: Scene, place: Place, over: bool, free: bool) -> None:
        """Turn, move and zoom the surfaces, or show one of them large; what began over them may go on outside."""
        io, delta = imgui.GetIO(), tuple(imgui.GetIO().MouseDelta)
        if over and imgui.IsMouseClicked(0):
            self._turned = self.over, place
            self._clicked_twice = place if imgui.IsMouseDoubleClicked(0) else None
        elif self._turned is not None and delta != (0, 0):
            name, before = self._turned
            if name in scene.shown:
                scene.rotate(name, before, place)
                self._turned = name, place
        if over and imgui.IsMouseReleased(0) and self._clicked_twice is not None:
            if math.dist(place, self._clicked_twice) <= _STILL:
                scene.enlarge("" if len(scene.shown) < len(scene.names) else self.over)
            self._clicked_twice = None
        pressed = any(imgui.IsMouseClicked(button) for button in _MOVING)
        held = any(imgui.IsMouseDown(button) for button in _MOVING)
        if self._moves and held and free and delta != (0, 0):
            scene.move(delta)
        self._moves = held and free and (self._moves or (over and pressed))
        if over and io.MouseWheel:
            scene.zoom(self.over, place, _NEARER**io.MouseWheel)

    def _edit_gaussian(self, session: Session, scene: Scene, place: Place) -> None:
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

    def _place_point(self, session: Session, scene: Scene, place: Place, over: bool) -> None:
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

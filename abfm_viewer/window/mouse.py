"""The mouse over the surfaces, which turns, moves and edits them."""

import math
import time
from dataclasses import dataclass, replace

import polyscope.imgui as imgui

from abfm_viewer.document.document import SIDES, Landmark, Side
from abfm_viewer.scene.scene import DrawnLandmark, Scene
from abfm_viewer.scene.slots import Place
from abfm_viewer.session import active_gaussian
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.widget_record import Rect

_CLICK_PIXELS_MAX = 4.0  # motion of the mouse during a click
_MOVING_BUTTONS = (1, 2)  # right and middle
_ZOOM_FACTOR = 1.15  # for one notch of the wheel
_WHEEL_PAUSE_SECONDS = 0.5  # a pause of the wheel that ends a step of undo
_MISSED_CLICK_MESSAGE = "no landmark was placed: click on a surface"
_NO_GAUSSIAN = "this surface has no Gaussian; Shift-click on the source or target to move theirs"


@dataclass(frozen=True)
class _Turn:
    surface: str  # in whose slot the drag began
    place: Place  # present place of the mouse
    orbits: bool  # whether the drag began next to the surface


class Mouse:
    """State of the mouse between frames."""

    def __init__(self) -> None:
        self.over = ""  # surface in whose slot the mouse is
        self._edited: Side | None = None
        self._dragged: DrawnLandmark | None = None
        self._landmarks: tuple[Landmark, ...] = ()  # after the last motion of the drag
        self._wheel_until = 0.0
        self._pressed_at: Place | None = None
        self._turned: _Turn | None = None
        self._double_click: Place | None = None  # of a double click whose button is held
        self._moves = False

    @property
    def dragging(self) -> bool:
        """Whether the mouse changes a Gaussian or a landmark; a drag is a single undo step."""
        is_dragging = self._edited is not None or self._dragged is not None
        return is_dragging or time.perf_counter() < self._wheel_until

    def update(self, session: Session, scene: Scene, rect: Rect, free: bool) -> None:
        """Do the actions of the mouse over the surfaces in this frame.

        ``free`` is false if the mouse cannot be used for surfaces, for example below a dialog.
        """
        io = imgui.GetIO()
        x, y = place = tuple(io.MousePos)
        inside = rect[0] <= x < rect[2] and rect[1] <= y < rect[3]
        over = free and inside and not io.WantCaptureMouse and bool(scene.names)
        self.over = scene.view.slot_at(place) if over else ""
        if not (free and imgui.IsMouseDown(0)):
            self._edited = self._turned = self._dragged = None
        ours = (over and io.KeyShift) or self._edited is not None
        if ours:
            imgui.SetMouseCursor(imgui.ImGuiMouseCursor_Hand)
            self._edit_gaussian(session, scene, place)
        elif self._drag_landmark(session, scene, place, over):
            imgui.SetMouseCursor(imgui.ImGuiMouseCursor_Hand)
            ours = True
        elif scene.names:  # a drag may continue outside the surfaces
            self._turn(scene, place, over)
            self._enlarge(session, scene, place, over)
            self._move(scene, over, free)
            if over and io.MouseWheel:
                scene.set_view(scene.view.zoomed(self.over, place, _ZOOM_FACTOR**io.MouseWheel))
        self._place_point(session, scene, place, over and not ours)

    def _turn(self, scene: Scene, place: Place, over: bool) -> None:
        if over and imgui.IsMouseClicked(0):
            self._turned = _Turn(self.over, place, orbits=not scene.covers(self.over, place))
            return
        turned = self._turned
        if turned is None or turned.place == place or turned.surface not in scene.shown:
            return
        if turned.orbits:
            delta = (place[0] - turned.place[0], place[1] - turned.place[1])
            scene.set_view(scene.view.orbited(delta))
        else:
            scene.set_view(scene.view.turned(turned.surface, turned.place, place))
        self._turned = replace(turned, place=place)

    def _enlarge(self, session: Session, scene: Scene, place: Place, over: bool) -> None:
        if over and imgui.IsMouseClicked(0):
            self._double_click = place if imgui.IsMouseDoubleClicked(0) else None
        if over and imgui.IsMouseReleased(0) and self._double_click is not None:
            if math.dist(place, self._double_click) <= _CLICK_PIXELS_MAX:
                enlarged = "" if len(scene.shown) < len(scene.names) else self.over
                session.editor.amend(view=replace(session.view, enlarged=enlarged))
            self._double_click = None

    def _move(self, scene: Scene, over: bool, free: bool) -> None:
        delta = tuple(imgui.GetIO().MouseDelta)
        is_down = free and any(imgui.IsMouseDown(button) for button in _MOVING_BUTTONS)
        if self._moves and is_down and delta != (0, 0):
            scene.set_view(scene.view.moved(delta))
        begins = over and any(imgui.IsMouseClicked(button) for button in _MOVING_BUTTONS)
        self._moves = is_down and (self._moves or begins)

    def _edit_gaussian(self, session: Session, scene: Scene, place: Place) -> None:
        """Grab, move or widen a Gaussian; not in every frame, as finding a vertex is slow."""
        io = imgui.GetIO()
        # with Shift, some systems report the wheel as horizontal
        notches = io.MouseWheel or io.MouseWheelH
        pressed = bool(imgui.IsMouseClicked(0))
        moved = self._edited is not None and tuple(io.MouseDelta) != (0, 0)
        if not (pressed or moved or notches) or (hit := scene.pick(place)) is None:
            return
        side = next((side for side in SIDES if side == hit.surface), None)
        if side is None:
            if pressed:
                session.notices.show(_NO_GAUSSIAN)
        elif self._edited is None and pressed:
            if reason := active_gaussian.obstacle_to_move(session, side):
                session.notices.show(reason)
                return
            session.editor.seal()
            self._edited = side
            active_gaussian.move(session, side, hit.vertex, f"drag {side}")
        elif self._edited == side and moved:
            active_gaussian.move(session, side, hit.vertex, f"drag {side}")
        elif self._edited is None and notches:
            self._wheel_until = time.perf_counter() + _WHEEL_PAUSE_SECONDS
            active_gaussian.widen(session, side, notches, f"wheel {side}")

    def _drag_landmark(self, session: Session, scene: Scene, place: Place, over: bool) -> bool:
        """Move a landmark along its surface; return whether the mouse is over or moves one."""
        if self._dragged is None:
            is_busy = self._turned is not None or self._moves or imgui.GetIO().MouseWheel
            if not over or is_busy or any(map(imgui.IsMouseDown, _MOVING_BUTTONS)):
                return False
            landmark = scene.landmark_at(place)
            if landmark is not None and imgui.IsMouseClicked(0):
                session.editor.seal()
                session.editor.select(landmark=landmark.number)
                self._dragged, self._pressed_at = landmark, None
                self._landmarks = session.document.landmarks
            return landmark is not None
        landmark = self._dragged
        if session.document.landmarks is not self._landmarks:  # removed or undone in the meantime
            self._dragged = None
            return False
        if tuple(imgui.GetIO().MouseDelta) == (0, 0) or landmark.side is None:
            return True
        hit = scene.pick(place)
        if hit is not None and hit.surface == landmark.surface:
            label = f"drag landmark {landmark.number} {landmark.side}"
            session.editor.move_landmark(landmark.number, landmark.side, hit.point, label)
            self._landmarks = session.document.landmarks
        return True

    def _place_point(self, session: Session, scene: Scene, place: Place, over: bool) -> None:
        """Place a landmark or a point at a left click, as chosen in the tab Look."""
        if imgui.IsMouseClicked(0):
            places = over and session.view.tool != "nothing" and not imgui.IsMouseDoubleClicked(0)
            self._pressed_at = place if places else None
        if imgui.IsMouseReleased(0) and self._pressed_at is not None:
            is_click = math.dist(place, self._pressed_at) <= _CLICK_PIXELS_MAX
            self._pressed_at = None
            hit = scene.pick(place) if is_click else None
            if is_click and hit is None and session.view.tool == "landmark":
                session.notices.show(_MISSED_CLICK_MESSAGE)
            if hit is not None:
                if session.view.tool == "landmark":
                    side: Side = "source" if hit.surface == "source" else "target"
                    session.editor.place_landmark(side, hit.point)
                    return
                is_line = session.view.tool == "flow line"
                session.place_point("lines" if is_line else "points", hit.surface, hit.point)

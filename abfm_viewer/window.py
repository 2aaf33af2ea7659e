"""The app's window: where everything is, and the loop that draws it."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polyscope.imgui as imgui
from PIL import Image

from abfm.io import write_atomically
from abfm_viewer import opengl, style
from abfm_viewer.annotations import draw_annotations
from abfm_viewer.background import one_line
from abfm_viewer.document import Theme
from abfm_viewer.opengl import ps
from abfm_viewer.panels import menus, right_panel, status_line, time_bar
from abfm_viewer.scene import Scene
from abfm_viewer.session import Session
from abfm_viewer.ui import Rect, Ui

_SECONDS_PER_FRAME, _LEAST_SLEEP = 1 / 30, 0.002
_PANEL_WIDTH, _WIDEST_PANEL = 380, 0.5
_TIME_BAR_HEIGHT, _STATUS_HEIGHT = 82, 28


@dataclass(frozen=True)
class Areas:
    """The parts of the window."""

    scene: Rect
    panel: Rect
    time_bar: Rect
    status: Rect


def areas(size: tuple[float, float], menu_height: float, scale: float) -> Areas:
    """Divide a window: a panel at the right, time bar and status line at the bottom, and surfaces in the rest."""
    width, height = size
    right = max(width - min(_PANEL_WIDTH * scale, _WIDEST_PANEL * width), 1.0)
    status = height - _STATUS_HEIGHT * scale
    bar = status - _TIME_BAR_HEIGHT * scale
    return Areas(
        scene=(0.0, menu_height, right, max(bar, menu_height + 1)),
        panel=(right, menu_height, width, status),
        time_bar=(0.0, bar, right, status),
        status=(0.0, status, width, height),
    )


class Window:
    """Draws a session and passes on what the user does.

    Attributes
    ----------
    session : Session
    ui : Ui
    scene : Scene
    frames : int
        How many were drawn.
    errors : dict of str to str
        Parts of the window that raised an error in the latest frame, which they show instead.
    parts : Areas
        Where they were in the latest frame.
    """

    def __init__(
        self, session: Session, backend: opengl.Backend = opengl.WINDOW, size: tuple[int, int] = (1600, 1000)
    ) -> None:
        self.session = session
        self.ui = Ui()
        self.frames = 0
        self.errors: dict[str, str] = {}
        self.closing = False
        self.parts = areas(size, 0, 1)
        self._capturing = False
        self._style: tuple[Theme, float] | None = None
        opengl.start(backend, *size, title="abfm")
        ps.set_build_default_gui_panels(False)
        ps.set_open_imgui_window_for_user_callback(False)
        ps.set_max_fps(-1)  # the GIL is held while polyscope waits for the next frame; `frame` waits without it
        ps.set_frame_tick_limit_fps_mode("ignore_limits")
        ps.set_configure_imgui_style_callback(self._restyle)
        ps.set_user_callback(self._callback)
        self.scene = Scene()

    def run(self) -> None:
        """Draw frames until the window is closed."""
        try:
            while not self.closing:
                self.frame()
                self.closing = self.closing or ps.window_requests_close()
        finally:
            self.close()

    def close(self) -> None:
        """End all threads, and draw nothing any more."""
        ps.clear_user_callback()
        self.session.close()

    def frame(self) -> None:
        """Draw one frame and leave the rest of its time to the solver."""
        start = time.perf_counter()
        self.tick()
        time.sleep(max(_LEAST_SLEEP, _SECONDS_PER_FRAME - (time.perf_counter() - start)))

    def tick(self) -> None:
        """Draw one frame."""
        ps.frame_tick()

    def screenshot(self, path: Path) -> None:
        """Write a picture (PNG) of the whole window: the panels as they are, though nothing is hovered or open."""
        self._capturing = True  # polyscope calls back four times more, without a mouse
        try:
            pixels = ps.screenshot_to_buffer(transparent_bg=False, include_UI=True)
        finally:
            self._capturing = False
        with write_atomically(path) as temporary:
            Image.fromarray(np.ascontiguousarray(pixels[:, :, :3])).save(temporary, format="png")

    def guarded(self, part: str, draw: Callable[[], None]) -> None:
        """Draw a part of the window; if it raises, show the error in its place and live on."""
        try:
            draw()
        except Exception as error:
            if part not in self.errors:
                traceback.print_exc()
            self.errors[part] = one_line(error)
            self.session.say(f"{part}: {one_line(error)}", is_error=True)
        else:
            self.errors.pop(part, None)

    def _callback(self) -> None:
        """Draw one frame; an exception that escaped would stop polyscope from drawing ever again."""
        if not self._capturing:
            self.frames += 1
        view = self.session.view
        if self._style is None or self._style[1] != view.ui_scale:
            ps.set_ui_scale(view.ui_scale)
        if self._style != (view.theme, view.ui_scale):
            self._style = (view.theme, view.ui_scale)
            self._restyle()
        self.ui.begin_frame(view.ui_scale, view.theme)
        if not self._capturing:
            self.guarded("session", self._update)
        parts = self.parts = areas(imgui.GetIO().DisplaySize, imgui.GetFrameHeight(), view.ui_scale)
        self.guarded("scene", lambda: self.scene.update(self.session, parts.scene))
        self.guarded("labels", lambda: draw_annotations(self.ui, self.scene, parts.scene))
        self.guarded("menu", lambda: menus.draw(self.ui, self.session))
        self.guarded("panel", lambda: right_panel.draw(self.ui, self.session, parts.panel, self.guarded))
        self.guarded("time bar", lambda: time_bar.draw(self.ui, self.session, parts.time_bar))
        self.guarded("status line", lambda: status_line.draw(self.ui, self.session, parts.status))

    def _update(self) -> None:
        active = bool(imgui.IsAnyItemActive())
        if self.session.dragging and not active:
            self.session.history.seal()
        self.session.dragging = active
        self.session.update()

    def _restyle(self) -> None:
        view = self.session.view
        style.apply(view.theme, view.ui_scale)

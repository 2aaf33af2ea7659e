"""The window of the app: its areas and its frame loop."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TypeAlias

import numpy as np
import polyscope.imgui as imgui
from PIL import Image

from abfm import TriangleMesh
from abfm.assets import asset_path
from abfm.errors import SeveralArraysError
from abfm.io import write_atomically
from abfm.mesh.options import DEFAULT_OPTIONS, MeshOptions
from abfm_viewer import signals
from abfm_viewer.computing.background import error_line
from abfm_viewer.computing.freed_memory import limit_pools
from abfm_viewer.dialogs import native_dialog
from abfm_viewer.dialogs.dialogs import FileKind
from abfm_viewer.document.document import Theme
from abfm_viewer.files.contents import PROJECT, RESULT
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.panels import cards, result_table, right_panel, status_line, time_bar
from abfm_viewer.panels.context import Context
from abfm_viewer.scene import opengl
from abfm_viewer.scene.annotations import (
    GaussianMarkers,
    bars_height,
    draw_annotations,
    name_height,
    window_pen,
)
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.pacing import Supersampling
from abfm_viewer.scene.scene import Scene
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import OTHER_NAME, find_first, open_session, session_of
from abfm_viewer.widgets import style
from abfm_viewer.widgets.containers import is_popup_open, window
from abfm_viewer.widgets.widget_record import Rect, write_widgets
from abfm_viewer.window import menus, warm_up
from abfm_viewer.window.actions import Actions
from abfm_viewer.window.library_warnings import LibraryWarnings
from abfm_viewer.window.mouse import Mouse
from abfm_viewer.window.previews import Previews
from abfm_viewer.window.recovery import Recoveries
from abfm_viewer.window.search import Search
from abfm_viewer.window.session_preferences import SessionPreferences
from abfm_viewer.window.tour import PANEL, SCENE, TIME_BAR, Tour
from abfm_viewer.window.window_title import WindowTitle

_SECONDS_PER_FRAME = 1 / 30
_SECONDS_PER_IDLE_FRAME = 1 / 10
_SLEEP_SECONDS_MIN = 0.002
_DOUBLE_CLICK_SECONDS = 0.5  # as on most desktops; ImGui's 0.3 s are too short for slow frames
_IDLE_SECONDS = 1.0  # without motion, after which frames are drawn less often
_PANEL_WIDTH = 380
_PANEL_WIDTH_SHARE_MAX = 0.48  # of the window
_STATUS_HEIGHT = 30
_BUNDLED_MESH = "human_fine_A.off"


Openable: TypeAlias = str | Path | TriangleMesh | tuple[str | Path, ...] | None
"""Inputs that a window can open.

A mesh, project, result or folder of results; the meshes of surfaces A and B; or a mesh and frames,
optionally with the name of the array of the frames.
"""


@dataclass(frozen=True)
class Areas:
    scene: Rect
    panel: Rect
    time_bar: Rect
    status: Rect
    table: Rect  # between the surfaces and the time bar; its height is 0 if no table is open


def areas(
    size: tuple[float, float], menu_height: float, scale: float, has_table: bool = False
) -> Areas:
    """Return the areas of a window: a panel at the right; below, table, time bar and status line.

    ``scale`` is the scale of the window; all other lengths are in pixels.
    """
    width, height = size
    right = max(width - min(_PANEL_WIDTH * scale, _PANEL_WIDTH_SHARE_MAX * width), 1.0)
    status = height - _STATUS_HEIGHT * scale
    bar = status - time_bar.height(right, scale)
    table = bar - (result_table.height(bar - menu_height, scale) if has_table else 0.0)
    return Areas(
        scene=(0.0, menu_height, right, max(table, menu_height + 1)),
        panel=(right, menu_height, width, status),
        time_bar=(0.0, bar, right, status),
        status=(0.0, status, width, height),
        table=(0.0, table, right, bar),
    )


def open_window(
    inputs: Openable,
    backend: opengl.Backend,
    size: tuple[int, int],
    state_folder: Path | None = None,
    options: MeshOptions = DEFAULT_OPTIONS,
) -> Window:
    """Open the window of the app, by default with a bundled mesh.

    Of two meshes, the first is registered to the second. If a file of frames has several arrays, a
    dialog lets the user choose one. Preferences, recent files and autosaves are in the state
    folder, by default that of the user. Raises `AbfmError` if a file cannot be read, or the machine
    cannot draw.
    """
    state, table, ambiguous = StateFolder(state_folder), None, None
    if isinstance(inputs, TriangleMesh):
        session = Session(inputs, "mesh")
    else:
        given = inputs if isinstance(inputs, tuple) else (inputs,) if inputs else ()
        paths, array = [Path(one) for one in given[:2]], str(given[2]) if given[2:] else None
        first, *second = paths or [asset_path(_BUNDLED_MESH)]
        table = None if second else find_first(first)
        if table is not None and table.opened is not None:
            session = session_of(table.opened)
        else:
            first = asset_path(_BUNDLED_MESH) if table else first
            try:
                second_path = second[0] if second else None
                session = open_session(first, options, second_path, array)
            except SeveralArraysError:
                ambiguous = second_path
                session = open_session(first, options)
    window = Window(session, backend, size, state)
    if not isinstance(inputs, TriangleMesh) and paths:
        window.files.record_paths(*paths[: 1 if ambiguous else 2])
        kind: FileKind = "results" if table or first.suffix in (PROJECT, RESULT) else "meshes"
        window.dialogs.remember_folder(kind, paths[0].absolute().parent)
    if table is not None:
        window.files.tables.take(table)
    if ambiguous is not None:
        window.files.open_frames(ambiguous)
    return window


class Window(Context):
    """The window of a session."""

    def __init__(
        self,
        session: Session,
        backend: opengl.Backend,
        size: tuple[int, int],
        state: StateFolder | None = None,
    ) -> None:
        super().__init__(session, state)
        self.session_preferences = SessionPreferences(session, self.preferences)
        self.previews = Previews(self.textures)
        self.dialogs.preview = self.previews.find
        parts = self.files, self.dialogs, self.textures
        self.recoveries = Recoveries(session, state, *parts) if state else None
        self.search, self.tour = Search(self, self._draw_unseen), Tour(self)
        self.mouse = Mouse()
        over, search = (lambda: self.mouse.over), self.search.open
        self.actions = Actions(self, over, self._end, search, self.tour)
        self.files.file_actions[OTHER_NAME] = self.actions.save_as.do
        self.frames = 0  # number of drawn frames
        self.errors: dict[str, str] = {}  # of the latest frame, by part of the window
        self._warnings = LibraryWarnings()
        self._drawn: set[str] = set()
        self.closing = False
        self.interrupted: int | None = None  # number of the received signal
        self.parts = areas(size, 0, 1)  # of the latest frame
        self._redraws = self._active = self._is_busy = False
        self._panel_seconds = self._moved_at = self._last_redraw = 0.0
        self._document: object = None
        self._style: tuple[Theme, float] = ("light", 0.0)  # replaced in the first frame
        limit_pools()
        opengl.reserve_core_for_solver()
        opengl.start(backend, *size, title="abfm")
        ps.set_build_default_gui_panels(False)
        ps.set_open_imgui_window_for_user_callback(False)
        # if polyscope waited for the next frame, it would block other threads; `frame` waits
        ps.set_max_fps(-1)
        ps.set_frame_tick_limit_fps_mode("ignore_limits")
        ps.set_configure_imgui_style_callback(self._restyle)
        ps.set_files_dropped_callback(self._dropped)
        ps.set_do_default_mouse_interaction(False)
        ps.set_user_callback(self._callback)
        self.scene = Scene(self.shown)
        self.scene.choose_fronts()  # before other threads of the first frame delay it
        self.supersampling = Supersampling(backend == opengl.WINDOW)
        self.title = WindowTitle()
        self.gaussian_markers = GaussianMarkers()

    def run(self) -> None:
        """Draw frames until the window is closed.

        A signal that ends programs raises `EndedBySignal`, a KeyboardInterrupt, after the last
        frame. An exception inside a frame would stop polyscope permanently.
        """
        with signals.signal_handler(self._interrupt):
            try:
                self.frame()
                warm_up.start()
                self.dialogs.uses_native = lambda: (
                    self.preferences.now.native_dialogs and not native_dialog.missing()
                )
                while not self.closing:
                    self.frame()
                    if ps.window_requests_close():
                        self._once("closing", self.actions.quit.do)
            finally:
                self.close()
        if self.interrupted is not None:
            raise signals.EndedBySignal(self.interrupted)

    def close(self) -> None:
        ps.clear_user_callback()
        ps.clear_files_dropped_callback()
        # otherwise polyscope would call this window after Python has ended
        ps.clear_configure_imgui_style_callback()
        self.files.close()
        self.previews.close()
        if self.recoveries:
            self.recoveries.close(keep_unsaved=self.interrupted is not None)
        self.exporter.close()
        self._warnings.close()
        self.shown.close()
        self.session.close()

    def frame(self) -> None:
        """Draw one frame, and then sleep so that other threads can work.

        polyscope blocks other threads while it draws; without a graphics card it draws nearly
        always. While a file is loaded or functions are evaluated, the sleep is as long as the
        drawing.
        """
        start = time.perf_counter()
        self.tick()
        now = time.perf_counter()
        is_idle = now - self._moved_at >= _IDLE_SECONDS
        seconds = _SECONDS_PER_IDLE_FRAME if is_idle else _SECONDS_PER_FRAME
        drawing, session = now - start, self.session
        waits = session.loading.now is not None or session.functions.waiting_since is not None
        waits = waits or self.previews.busy
        time.sleep(max(drawing if waits else _SLEEP_SECONDS_MIN, seconds - drawing))

    def tick(self) -> None:
        start = time.perf_counter()
        ps.frame_tick()
        if self._redraws:
            seconds = time.perf_counter() - start - self._panel_seconds
            # the smaller one, because other processes may delay a redraw
            shortest = self.scene.pacing.redraw_seconds = min(seconds, self._last_redraw)
            self.supersampling.record(shortest or seconds)
            self._last_redraw = seconds

    def screenshot(self, path: Path) -> None:
        """Write a PNG picture of the window, without hovered widgets and open popups."""
        self.ui.capturing = True  # polyscope calls back four more times, without a mouse
        try:
            with self.supersampling.still_picture():
                pixels = ps.screenshot_to_buffer(transparent_bg=False, include_UI=True)
        finally:
            self.ui.capturing = False
        with write_atomically(path) as temporary:
            Image.fromarray(np.ascontiguousarray(pixels[:, :, :3])).save(temporary, format="png")

    def guarded(self, part: str, draw: Callable[..., None], *given: object) -> None:
        """Draw a part of the window; if that fails, show the message of the error."""
        try:
            draw(*given)
        except Exception as error:
            if part not in self.errors:
                traceback.print_exc()
            self.errors[part] = error_line(error)
            self.session.notices.show(f"{part}: {error_line(error)}", is_error=True)
        else:
            self.errors.pop(part, None)
        self._drawn.add(part)

    def _callback(self) -> None:
        """Draw one frame; no exception may escape, as it would stop polyscope permanently."""
        start = time.perf_counter()
        self._draw()
        self._redraws = bool(ps.get_redraw_requested())
        if not self.ui.capturing:
            self.supersampling.update(self._redraws, self._is_busy)
        self._panel_seconds = time.perf_counter() - start

    def _draw(self) -> None:
        view, is_live = self.session.view, not self.ui.capturing
        self.frames += is_live
        keys_are_free = is_live and not is_popup_open()  # Escape closes a popup
        if self._style != (style_now := (view.theme, view.ui_scale)):
            if self._style[1] != view.ui_scale:
                ps.set_ui_scale(view.ui_scale)
            self._style = style_now
            self._restyle()
        self.ui.begin_frame(view.ui_scale, view.theme)
        if is_live:
            self.guarded("session", self._update)
        io = imgui.GetIO()
        has_table = self.files.tables.is_of_document
        sizes = io.DisplaySize, imgui.GetFrameHeight(), view.ui_scale
        parts = self.parts = areas(*sizes, has_table)
        self._draw_scene(parts.scene, is_live)
        with self.ui.disabled(self.dialogs.is_open):
            self.guarded("menu", menus.draw, self.ui, self.actions)
            self.guarded("panel", right_panel.draw, self, parts.panel, self.guarded)
            if has_table:
                self.guarded("table", result_table.draw, self, parts.table)
            self.guarded("time bar", time_bar.draw, self, parts.time_bar)
            self.guarded("status line", status_line.draw, self, parts.status)
            self.guarded("messages", self._draw_cards, parts.scene)
        keys_are_free = keys_are_free and not self.dialogs.is_open
        self.guarded("dialog", self.dialogs.draw, self.ui)
        if keys_are_free:
            self.guarded("keyboard", self.actions.do_pressed)
        self.guarded("search", self.search.update)
        targets = {SCENE: parts.scene, TIME_BAR: parts.time_bar, PANEL: parts.panel}
        self.guarded("tour", self.tour.draw, targets)
        if is_live:
            self.errors = {part: self.errors[part] for part in self.errors if part in self._drawn}
            self._drawn.clear()
            self.ui.record.end_frame()
            self.guarded("widget file", write_widgets, self.ui.widgets, self.frames)

    def _draw_unseen(self) -> None:
        """Draw all menus and tabs, for the record of widgets that are not visible."""
        with window(self.ui, "unseen", (-1e4, -1e4, -9e3, -9e3)):
            self.guarded("menu", menus.draw_menus, self.ui, self.actions)
            right_panel.list_tabs(self, self.guarded)

    def _draw_scene(self, rect: Rect, is_live: bool) -> None:
        ui, session, scene = self.ui, self.session, self.scene
        left, top, right, bottom = rect
        self.exporter.window_size = (round(right - left), round(bottom - top))
        pen, has_bar = window_pen(ui), session.view.color_bar
        scene.pixels, scene.name_height = pen.scale, name_height(pen)
        scene.bars_height = bars_height(pen, bottom - top) if has_bar else 0.0
        self.guarded("scene", scene.update, rect)
        if is_live:
            self.guarded("mouse", self.mouse.update, session, scene, rect, not self.dialogs.is_open)
        self.guarded("markers", self.gaussian_markers.draw, ui, session, scene, rect)
        self.guarded("labels", draw_annotations, ui, scene, rect, has_bar)

    def _draw_cards(self, rect: Rect) -> None:
        left, top, right, bottom = rect
        scene = self.scene
        captions = [scene.view_of(name).label(name) for name in scene.shown]
        cards.draw(self, (left, top, right, bottom - scene.bars_height), captions)

    def _update(self) -> None:
        self._is_busy = self._moves()
        if self._is_busy:
            self._moved_at = time.perf_counter()
        active = bool(imgui.IsAnyItemActive()) or self.mouse.dragging
        if self._active and not active:
            self.session.editor.seal()
        self._active = active
        # typed text is evaluated before a run follows it
        is_down = active and bool(imgui.IsMouseDown(0))
        self.session.dragging = is_down or self.mouse.dragging
        self.session.player.waiting = not self.shown.is_ready
        self._warnings.update(self.session.notices)
        self.session.update()
        self.files.update()
        self.exporter.subject = self.session.document.identity
        self.title.show(f"{self.session.saves.title} - abfm")
        if self.recoveries:
            self.recoveries.update()
            self.list_copies = self.recoveries.list_copies if self.recoveries.copies else None
        self.session_preferences.update()

    def _moves(self) -> bool:
        """Return whether this frame may differ from the last one: after a change, input or work."""
        session, io = self.session, imgui.GetIO()
        changed = session.document is not self._document
        self._document = session.document
        by_hand = tuple(io.MouseDelta) != (0, 0) or io.MouseWheel != 0 or imgui.IsAnyMouseDown()
        moving = session.view.streaks and session.view.animate
        is_running = session.solver.running and not session.solver.paused
        working = is_running or self.shown.busy != "" or moving
        return changed or by_hand or imgui.IsAnyItemActive() or working

    def _dropped(self, files: list[str]) -> None:
        if files:
            self._once("drop", self.files.open_dropped, [Path(file) for file in files])

    def _once(self, part: str, do: Callable[..., None], *given: object) -> None:
        """Call a function between frames; an error of it is shown once in the status line."""
        self.guarded(part, do, *given)
        self.errors.pop(part, None)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.closing, self.interrupted = True, number

    def _end(self) -> None:
        self.closing = True

    def _restyle(self) -> None:
        view = self.session.view
        imgui.GetIO().MouseDoubleClickTime = _DOUBLE_CLICK_SECONDS
        style.apply(view.theme, view.ui_scale)

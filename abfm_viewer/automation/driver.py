"""`Driver`, which operates the app by the labels of its widgets, for tests and scripts.

Each action consists of events of a mouse and a keyboard, with frames drawn between them.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np

from abfm import TriangleMesh
from abfm.pages.front import Front, triple
from abfm.types import FloatArray
from abfm_viewer.automation.input_events import InputEvents, Place
from abfm_viewer.automation.widget_search import WidgetSearch, middle
from abfm_viewer.document.document import SIDES, Viewpoint
from abfm_viewer.errors import DriverError as DriverError
from abfm_viewer.scene.opengl import OFFSCREEN_BACKEND, Backend, ps
from abfm_viewer.scene.scene import Hit
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.widget_record import KINDS, Widget, WidgetKind
from abfm_viewer.window.window import Openable, open_window

_CLICKABLE_KINDS: tuple[WidgetKind, ...] = tuple(kind for kind in KINDS if kind != "plot")
_OPEN_SECONDS_MAX = 120.0
_OVERSHOOT_PIXELS = 10.0  # distance of a drag beyond the end of a slider
_TOOLTIP_FRAMES = 30  # number of frames until a tooltip is shown
_GRAB_PADDING_PIXELS = 2.0  # padding of a slider's grab in ImGui
_ZOOMS = (1.0, 4.0)  # zooms that are tried to make a vertex visible
_PICK_PIXELS_MAX = 12.0  # maximum distance of a click from its vertex, if nothing is drawn
_SHIFT = ("shift",)


class Driver:
    """The app with a simulated mouse and keyboard; a context manager.

    It closes without a question, also after an exception. Labels are the texts that the user reads
    on the widgets. `session` is the document and the solver, `input` the mouse and the keyboard.

    Parameters
    ----------
    mesh : str, Path, TriangleMesh, pair of str or Path, or None
        A mesh, project or result file, a mesh object, or mesh files of surfaces A and B; by default
        a bundled mesh.
    backend : str
        "openGL3_egl" (no screen), "openGL3_glfw" (a window) or "openGL_mock". The last one draws
        nothing, and picks also hidden vertices. All drivers of a process must use the same one.
    size : (int, int)
        Width and height of the window, in pixels.
    state : Path or None
        Folder of preferences, recent files and unsaved work; by default a new, empty one.

    Raises
    ------
    AbfmError
        If the process has another backend, the file cannot be read, or the machine cannot draw.

    Examples
    --------
    >>> with Driver("mesh.off", size=(800, 600)) as gui:
    ...     gui.click("Match")
    ...     gui.wait(lambda s: s.solver.finished, seconds=60)
    ...     gui.drag("time", 0.5)
    ...     gui.screenshot("halfway.png")
    """

    def __init__(
        self,
        mesh: Openable = None,
        backend: Backend = OFFSCREEN_BACKEND,
        size: tuple[int, int] = (1600, 1000),
        state: Path | None = None,
    ) -> None:
        self._mesh, self._backend, self._size, self._state = mesh, backend, size, state
        self._closing = ExitStack()
        self.input = InputEvents(self.frames)

    def __enter__(self) -> Self:
        running = ps.get_render_engine_backend_name() if ps.is_initialized() else self._backend
        if running != self._backend:
            raise DriverError(
                f"this process already draws with {running}, so it cannot use {self._backend}; use "
                "one backend per process"
            )
        folder = self._state
        if folder is None:
            folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory()))
        try:
            self.window = open_window(self._mesh, self._backend, self._size, folder)
            self._closing.callback(self.input.release_all)
            self._closing.callback(self.window.close)
            if self._backend == "openGL_mock":
                self.window.scene.pick = self._nearest_vertex
            self.session = self.window.session
            self.search = WidgetSearch(self.window, self.input)
            self.wait(
                lambda session: all(session.values(side) is not None for side in SIDES),
                _OPEN_SECONDS_MAX,
            )
        except BaseException:
            self._closing.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.close()

    # Frames

    def frames(self, count: int = 1) -> None:
        """Draw frames without a pause."""
        for _ in range(count):
            self.window.tick()

    def wait(self, condition: Callable[[Session], object], seconds: float = 60) -> None:
        """Draw frames until a condition is true; raise `DriverError` after ``seconds``."""
        end = time.monotonic() + seconds
        while not condition(self.session):
            if time.monotonic() > end:
                session, busy = self.session, self.window.shown.busy
                raise DriverError(
                    f"the condition was not met within {seconds:g} s; solver: "
                    f"{session.solver.state.name.lower()}, busy: {busy or 'no'}, status line: "
                    f"{session.notices.latest.text or 'empty'}, errors: {self.errors}"
                )
            self.window.frame()
        self.frames(2)

    # What the window shows

    @property
    def errors(self) -> dict[str, str]:
        """Error messages of the latest frame, by the part of the window that failed."""
        return dict(self.window.errors)

    def labels(self) -> list[str]:
        """Return the labels of all drawn widgets."""
        self.frames(1)
        return list(dict.fromkeys(widget.label for widget in self.window.ui.widgets))

    def is_enabled(self, label: str, within: str = "") -> bool:
        return self.search.find(label, within, must_be_enabled=False).enabled

    def text_of(self, label: str, within: str = "", kind: WidgetKind | None = None) -> str:
        """Return the text of a box, combo, slider, checkbox ("on", "off") or section ("open")."""
        kinds = (kind,) if kind else None
        return self.search.find(label, within, kinds, must_be_enabled=False).text

    def screenshot(self, path: str | Path) -> None:
        """Write a PNG picture of the complete window, including panels."""
        self.frames(2)
        self.window.screenshot(Path(path))
        self.frames(1)

    # Widgets

    def click(self, label: str, within: str = "") -> None:
        """Click on a widget, or on an entry of a menu, which is opened first.

        The label is the text that the user reads, or the name of a parameter in files. ``within``
        is the name of the section, group, menu or dialog. All methods with a label raise
        `DriverError` if there is no such widget, it is disabled, or the label is ambiguous.
        """
        self._click(label, within, _CLICKABLE_KINDS)

    def double_click(self, label: str, within: str = "") -> None:
        """Click on a widget twice."""
        self._click(label, within, _CLICKABLE_KINDS, count=2)

    def hover(self, label: str, within: str = "") -> None:
        """Hold the mouse over a widget until its tooltip is shown."""
        self.search.point_at(self.search.find(label, within, must_be_enabled=False), middle)
        self.frames(_TOOLTIP_FRAMES)

    def menu(self, *labels: str) -> None:
        """Open menus and click on the last label: `menu("View", "Layout", "column")`."""
        for within, label in pairwise(("", *labels)):
            self._click(label, within, ("menu", "item"))

    def type(self, label: str, text: str, within: str = "", enter: bool = True) -> None:
        """Replace the text of a box, and press Enter if ``enter``."""
        self._click(label, within, ("box",))
        self.input.key("ctrl+a")
        self.input.write(text) if text else self.input.key("backspace")
        if enter:
            self.input.key("enter")

    def drag(self, label: str, value: float, within: str = "") -> None:
        """Drag a slider to a value in its units; raise `DriverError` if it is out of range."""
        widget = self.search.find(label, within, ("slider",))
        ends = widget.ends
        if ends.nearest(value) != value:
            raise DriverError(
                f"{label} cannot be {value:g}; expected {ends.low:g} to {ends.high:g}"
            )
        now = ends.nearest(float(widget.text))
        x, y = _on_slider(widget, value)
        # drag beyond the end of the slider, so that rounding cannot miss it
        x += {ends.low: -_OVERSHOOT_PIXELS, ends.high: _OVERSHOOT_PIXELS}.get(value, 0)
        self.search.point_at(widget, partial(_on_slider, value=now))
        self.input.drag(self.input.place, (x, y))

    def choose(self, label: str, choice: str, within: str = "") -> None:
        """Select an entry of a combo."""
        combo = self._click(label, within, ("combo",))
        self._click(choice, combo.name or combo.label, ("choice",))

    def check(self, label: str, on: bool = True, within: str = "") -> None:
        """Switch a checkbox on or off."""
        widget = self.search.find(label, within, ("checkbox",))
        if (widget.text == "on") != on:
            self._click_on(widget)

    def key(self, chord: str) -> None:
        """Press a key such as "space", "ctrl+z" or "f1"; raise `DriverError` for any other name."""
        self.input.key(chord)

    def _click(
        self, label: str, within: str, kinds: Sequence[WidgetKind], count: int = 1
    ) -> Widget:
        widget = self.search.find(label, within, kinds)
        self._click_on(widget, count)
        return widget

    def _click_on(self, widget: Widget, count: int = 1) -> None:
        def handle(widget: Widget) -> Place:
            # some rectangles include the label, whose end may be out of view
            left, top, _, bottom = widget.rect
            if widget.kind == "checkbox":
                return left + (bottom - top) / 2, (top + bottom) / 2
            return middle(widget, 0.3 if widget.kind in ("box", "combo") else 0.5)

        self.search.point_at(widget, handle)
        self.input.click(count)

    # Surfaces

    def pick(self, vertex: int, surface: str = "source", modifiers: Sequence[str] = _SHIFT) -> None:
        """Click on a vertex, numbered as in the mesh file.

        With Shift, as by default, this moves a Gaussian to the vertex. The surfaces turn so that
        the vertex is visible. Raises `DriverError` if it is hidden from all sides.
        """
        self.drag_on_surface([vertex], surface, modifiers)

    def drag_on_surface(
        self, vertices: Sequence[int], surface: str = "source", modifiers: Sequence[str] = _SHIFT
    ) -> None:
        """Press the mouse on the first vertex, like `pick`, and drag it over the others."""
        with self._aimed(vertices, surface, modifiers) as places:
            self.input.drag(*places)

    def wheel(
        self, turns: float, vertex: int, surface: str = "source", modifiers: Sequence[str] = _SHIFT
    ) -> None:
        """Turn the wheel over a vertex; with Shift, as by default, this widens a Gaussian."""
        with self._aimed([vertex], surface, modifiers) as places:
            self.input.move(*places[0])
            self.input.wheel(turns)

    def place(self, vertex: int, surface: str) -> Place:
        """Return the place in the window of a vertex, numbered as in the mesh file."""
        x, y, _ = self.window.scene.projected(surface, self._position(vertex, surface))[0]
        return float(x), float(y)

    @contextmanager
    def _aimed(
        self, vertices: Sequence[int], surface: str, modifiers: Sequence[str]
    ) -> Iterator[list[Place]]:
        """Press modifiers, make the first vertex visible, and yield the places of all vertices."""
        self.window.tick()
        before = self.session.view.viewpoint
        turned = self._make_visible(vertices[0], surface)
        try:
            places = [self.place(vertex, surface) for vertex in vertices]
            with self.input.holding(modifiers):
                yield places
        finally:
            if turned:
                self._set_viewpoint(before)
        self.window.tick()

    def _make_visible(self, vertex: int, surface: str) -> bool:
        """Turn the surfaces so that a vertex is visible; return whether they were turned."""
        if self._is_visible(vertex, surface):
            return False
        mesh, before = self.session.surface(surface).mesh, self.session.view.viewpoint
        target = triple(self._position(vertex, surface))
        for direction in _directions(mesh, mesh.local_vertex(vertex)):
            axis = np.eye(3)[1] if abs(direction[1]) < 0.9 else np.eye(3)[2]
            up = axis - (axis @ direction) * direction
            up /= np.linalg.norm(up)
            for zoom in _ZOOMS:
                of_surface = Viewpoint(Front(triple(direction), triple(up)), zoom, target)
                self._set_viewpoint(self.window.scene.common_viewpoint(surface, of_surface))
                self.window.tick()
                if self._is_visible(vertex, surface):
                    return True
        self._set_viewpoint(before)
        raise DriverError(
            f"vertex {vertex} of the {surface} is hidden from all sides; pick another vertex"
        )

    def _set_viewpoint(self, viewpoint: Viewpoint | None) -> None:
        self.session.editor.amend(view=replace(self.session.view, viewpoint=viewpoint))

    def _position(self, vertex: int, surface: str) -> FloatArray:
        shown, mesh = self.window.scene.shown, self.session.surface(surface).mesh
        if surface not in shown:
            raise DriverError(
                f"there is no surface {surface!r}; the surfaces are {', '.join(shown)}"
            )
        return np.asarray(mesh.vertices[mesh.local_vertex(vertex)])

    def _is_visible(self, vertex: int, surface: str) -> bool:
        x, y = self.place(vertex, surface)
        left, top, right, bottom = self.window.scene.view.slots[surface].rect
        if not (left < x < right and top < y < bottom):
            return False
        hit = self.window.scene.pick((x, y))
        local = self.session.surface(surface).mesh.local_vertex(vertex)
        return hit is not None and (hit.surface, hit.vertex) == (surface, local)

    def _nearest_vertex(self, position: Place) -> Hit | None:
        """Return the vertex nearest to a place in the window, for a backend that cannot pick."""
        scene, hits = self.window.scene, []
        for surface in scene.shown:
            mesh = self.session.surface(surface).mesh
            x, y, depth = scene.projected(surface, mesh.vertices).T
            distances = np.hypot(x - position[0], y - position[1])
            is_near = (distances <= max(distances.min(), 1)) & (distances < _PICK_PIXELS_MAX)
            near = np.flatnonzero(is_near)
            if len(near):
                vertex = near[np.argmin(depth[near])]
                hits.append((distances[vertex], scene.nearest(surface, mesh.vertices[vertex])))
        return min(hits, key=lambda hit: hit[0])[1] if hits else None


def _on_slider(widget: Widget, value: float) -> Place:
    """Return the place of a value on a slider, whose range ends half a grab before its sides."""
    left, _, right, _ = widget.rect
    inset = widget.grab / 2 + _GRAB_PADDING_PIXELS
    along = widget.ends.share_of(value) * (right - left - 2 * inset)
    return left + inset + along, middle(widget)[1]


def _directions(mesh: TriangleMesh, vertex: int) -> FloatArray:
    """Return unit vectors (D, 3) from which to look at a vertex, beginning with its normal."""
    corners = mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    around = np.random.default_rng(0).normal(size=(24, 3))
    tilted = normal + 0.8 * around / np.linalg.norm(around, axis=1)[:, None]
    directions = np.concatenate([normal[None], tilted])
    return np.asarray(directions / np.linalg.norm(directions, axis=1)[:, None])

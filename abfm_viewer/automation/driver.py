"""`Driver`: drives the running app by widget label, as a user would, for tests and scripts.

Every action is made of a mouse's and a keyboard's events, with frames drawn between them.
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
from abfm_viewer.window.window import What, open_window

_CLICKABLE_KINDS: tuple[WidgetKind, ...] = tuple(kind for kind in KINDS if kind != "plot")
_SECONDS_TO_OPEN = 120.0
_OVERSHOOT_PIXELS = 10.0  # pixels
_FRAMES_TO_A_TOOLTIP = 30
_GRAB_PADDING = 2.0  # pixels, ImGui's own
_ZOOMS = (1.0, 4.0)  # at which to look for a vertex
_REACH = 12.0  # pixels from a vertex within which it is found where nothing is drawn
_SHIFT = ("shift",)


class Driver:
    """The app with a mouse and a keyboard of ours; a context manager.

    It closes without asking, also after an exception. Labels are exactly what the user reads on a
    widget. Its `session` is the document and the solver, `input` the mouse and the keyboard.

    Parameters
    ----------
    mesh : str, Path, TriangleMesh, pair of str or Path, or None
        A mesh, project or result file, a mesh, or mesh files of surfaces A and B; by default a
        bundled mesh.
    backend : str
        "openGL3_egl" (no screen), "openGL3_glfw" (a window) or "openGL_mock" (draws nothing; there
        a vertex is picked though it is hidden). A process can have only one, any number of times.
    size : (int, int)
        Of the window, in pixels.
    state : Path or None
        The folder of preferences, recent files and unsaved work; by default an empty one.

    Raises
    ------
    AbfmError
        If the process has another backend, the file cannot be read, or the machine cannot draw.

    Examples
    --------
    >>> with Driver("mesh.off") as gui:
    ...     gui.click("Match")
    ...     gui.wait(lambda s: s.solver.finished, seconds=60)
    ...     gui.drag("time", 0.5)
    ...     gui.screenshot("halfway.png")
    """

    def __init__(
        self,
        mesh: What = None,
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
            what = f"this process draws with {running}, not {self._backend}"
            raise DriverError(f"{what}: use one backend per process")
        folder = self._state
        if folder is None:
            folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory()))
        try:
            self.window = open_window(self._mesh, self._backend, self._size, folder)
            self._closing.callback(self.input.let_go)
            self._closing.callback(self.window.close)
            if self._backend == "openGL_mock":
                self.window.scene.pick = self._nearest_vertex
            self.session = self.window.session
            self.search = WidgetSearch(self.window, self.input)
            self.wait(lambda s: all(s.values(side) is not None for side in SIDES), _SECONDS_TO_OPEN)
        except BaseException:
            self._closing.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.close()

    # Frames

    def frames(self, count: int = 1) -> None:
        for _ in range(count):
            self.window.tick()

    def wait(self, condition: Callable[[Session], object], seconds: float = 60) -> None:
        """Draw frames until a condition on the session holds, and two more; else a DriverError."""
        end = time.monotonic() + seconds
        while not condition(self.session):
            if time.monotonic() > end:
                session, busy = self.session, self.window.shown.busy
                raise DriverError(
                    f"waited {seconds:g} s in vain; solver: {session.solver.state.name.lower()}, "
                    f"busy: {busy or 'no'}, status line: {session.notices.latest.text or 'empty'}, "
                    f"errors: {self.errors}"
                )
            self.window.frame()
        self.frames(2)

    # What the window shows

    @property
    def errors(self) -> dict[str, str]:
        return dict(self.window.errors)

    def labels(self) -> list[str]:
        self.frames(1)
        return list(dict.fromkeys(widget.label for widget in self.window.ui.widgets))

    def is_enabled(self, label: str, within: str = "") -> bool:
        return self.search.find(label, within, must_be_enabled=False).enabled

    def text_of(self, label: str, within: str = "", kind: WidgetKind | None = None) -> str:
        """Return what a box, combo, slider, checkbox ("on", "off") or section ("open") shows."""
        kinds = (kind,) if kind else None
        return self.search.find(label, within, kinds, must_be_enabled=False).text

    def screenshot(self, path: str | Path) -> None:
        """Write a picture (PNG) of the whole window, panels included."""
        self.frames(2)
        self.window.screenshot(Path(path))
        self.frames(1)

    # Widgets

    def click(self, label: str, within: str = "") -> None:
        """Click on a widget, or on an entry of a menu, which is opened before.

        The label is what the user reads, or a parameter's name in files; `within` names the
        section, group, menu or dialog. DriverError, as for all that takes a label, if there is no
        such widget, it is grey, or the label ambiguous.
        """
        self._click(label, within, _CLICKABLE_KINDS)

    def double_click(self, label: str, within: str = "") -> None:
        self._click(label, within, _CLICKABLE_KINDS, count=2)

    def hover(self, label: str, within: str = "") -> None:
        """Hold the mouse over a widget until its tooltip is there."""
        self.search.point_at(self.search.find(label, within, must_be_enabled=False), middle)
        self.frames(_FRAMES_TO_A_TOOLTIP)

    def menu(self, *labels: str) -> None:
        """Open menus and click on the last label: `menu("View", "Layout", "column")`."""
        for within, label in pairwise(("", *labels)):
            self._click(label, within, ("menu", "item"))

    def type(self, label: str, text: str, within: str = "", enter: bool = True) -> None:
        """Replace the text of a box, and press Enter unless told not to."""
        self._click(label, within, ("box",))
        self.input.key("ctrl+a")
        self.input.write(text) if text else self.input.key("backspace")
        if enter:
            self.input.key("enter")

    def drag(self, label: str, value: float, within: str = "") -> None:
        """Drag a slider to a value in its own units; DriverError if it does not reach so far."""
        widget = self.search.find(label, within, ("slider",))
        ends = widget.ends
        if ends.nearest(value) != value:
            raise DriverError(f"{label} goes from {ends.low:g} to {ends.high:g}, not to {value:g}")
        now = ends.nearest(float(widget.text))
        x, y = _on_slider(widget, value)
        # an end is reached for sure
        x += {ends.low: -_OVERSHOOT_PIXELS, ends.high: _OVERSHOOT_PIXELS}.get(value, 0)
        self.search.point_at(widget, partial(_on_slider, value=now))
        self.input.drag(self.input.place, (x, y))

    def choose(self, label: str, choice: str, within: str = "") -> None:
        combo = self._click(label, within, ("combo",))
        self._click(choice, combo.name or combo.label, ("choice",))

    def check(self, label: str, on: bool = True, within: str = "") -> None:
        widget = self.search.find(label, within, ("checkbox",))
        if (widget.text == "on") != on:
            self._click_on(widget)

    def key(self, chord: str) -> None:
        """Press a key: "space", "ctrl+z", "f1", "a", ...; DriverError if there is no such key."""
        self.input.key(chord)

    def _click(
        self, label: str, within: str, kinds: Sequence[WidgetKind], count: int = 1
    ) -> Widget:
        widget = self.search.find(label, within, kinds)
        self._click_on(widget, count)
        return widget

    def _click_on(self, widget: Widget, count: int = 1) -> None:
        def handle(widget: Widget) -> Place:
            # rectangles of some kinds hold labels, whose end may be out of view
            left, top, _, bottom = widget.rect
            if widget.kind == "checkbox":
                return left + (bottom - top) / 2, (top + bottom) / 2
            return middle(widget, 0.3 if widget.kind in ("box", "combo") else 0.5)

        self.search.point_at(widget, handle)
        self.input.click(count)

    # Surfaces

    def pick(self, vertex: int, surface: str = "source", modifiers: Sequence[str] = _SHIFT) -> None:
        """Click on a vertex, numbered as in the mesh file; with Shift this moves a Gaussian.

        A vertex that cannot be seen is turned to the front; DriverError if every side hides it.
        """
        self.drag_on_surface([vertex], surface, modifiers)

    def drag_on_surface(
        self, vertices: Sequence[int], surface: str = "source", modifiers: Sequence[str] = _SHIFT
    ) -> None:
        """Press the mouse on the first vertex, as `pick` does, and drag it over the others."""
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
        """Return where a vertex, numbered as in the mesh file, is in the window."""
        x, y, _ = self.window.scene.projected(surface, self._position(vertex, surface))[0]
        return float(x), float(y)

    @contextmanager
    def _aimed(
        self, vertices: Sequence[int], surface: str, modifiers: Sequence[str]
    ) -> Iterator[list[Place]]:
        """Hold modifiers and give places of vertices, the first one turned to the front."""
        self.window.tick()
        before = self.session.view.viewpoint
        turned = self._turn_to(vertices[0], surface)
        try:
            places = [self.place(vertex, surface) for vertex in vertices]
            with self.input.holding(modifiers):
                yield places
        finally:
            if turned:
                self._look(before)
        self.window.tick()

    def _turn_to(self, vertex: int, surface: str) -> bool:
        """Turn the surfaces so that a vertex can be clicked on; whether that was needed."""
        if self._sees(vertex, surface):
            return False
        mesh, before = self.session.surface(surface).mesh, self.session.view.viewpoint
        target = triple(self._position(vertex, surface))
        for direction in _directions(mesh, mesh.local_vertex(vertex)):
            axis = np.eye(3)[1] if abs(direction[1]) < 0.9 else np.eye(3)[2]
            up = axis - (axis @ direction) * direction
            up /= np.linalg.norm(up)
            for zoom in _ZOOMS:
                own = Viewpoint(Front(triple(direction), triple(up)), zoom, target)
                self._look(self.window.scene.look_at(surface, own))
                self.window.tick()
                if self._sees(vertex, surface):
                    return True
        self._look(before)
        raise DriverError(
            f"vertex {vertex} of the {surface} is hidden from all sides: pick another"
        )

    def _look(self, viewpoint: Viewpoint | None) -> None:
        self.session.editor.amend(view=replace(self.session.view, viewpoint=viewpoint))

    def _position(self, vertex: int, surface: str) -> FloatArray:
        shown, mesh = self.window.scene.shown, self.session.surface(surface).mesh
        if surface not in shown:
            raise DriverError(f"there is no surface {surface!r}; surfaces are {', '.join(shown)}")
        position: FloatArray = mesh.vertices[mesh.local_vertex(vertex)]
        return position

    def _sees(self, vertex: int, surface: str) -> bool:
        x, y = self.place(vertex, surface)
        left, top, right, bottom = self.window.scene.view.slots[surface].rect
        if not (left < x < right and top < y < bottom):
            return False
        hit = self.window.scene.pick((x, y))
        local = self.session.surface(surface).mesh.local_vertex(vertex)
        return hit is not None and (hit.surface, hit.vertex) == (surface, local)

    def _nearest_vertex(self, position: Place) -> Hit | None:
        """Return the vertex drawn nearest to a place: for backends that draw nothing to pick."""
        scene, hits = self.window.scene, []
        for surface in scene.shown:
            mesh = self.session.surface(surface).mesh
            x, y, depth = scene.projected(surface, mesh.vertices).T
            distances = np.hypot(x - position[0], y - position[1])
            near = np.flatnonzero((distances <= max(distances.min(), 1)) & (distances < _REACH))
            if len(near):
                vertex = near[np.argmin(depth[near])]
                hits.append((distances[vertex], scene.nearest(surface, mesh.vertices[vertex])))
        return min(hits, key=lambda hit: hit[0])[1] if hits else None


def _on_slider(widget: Widget, value: float) -> Place:
    """Return where on a slider a value is; ImGui leaves half the grab free at both ends."""
    left, _, right, _ = widget.rect
    inset = widget.grab / 2 + _GRAB_PADDING
    along = widget.ends.share_of(value) * (right - left - 2 * inset)
    return left + inset + along, middle(widget)[1]


def _directions(mesh: TriangleMesh, vertex: int) -> FloatArray:
    """Return unit vectors to look from at a vertex: its normal first, and others around it."""
    corners = mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    around = np.random.default_rng(0).normal(size=(24, 3))
    tilted = normal + 0.8 * around / np.linalg.norm(around, axis=1)[:, None]
    directions = np.concatenate([normal[None], tilted])
    facing: FloatArray = directions / np.linalg.norm(directions, axis=1)[:, None]
    return facing

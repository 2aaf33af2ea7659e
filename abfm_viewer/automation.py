"""`Driver`: drives the running app by widget label, as a user would, for tests and scripts.

Every action is made of the events that a mouse and a keyboard send, with frames drawn between them, so what works here
works by hand. Labels are exactly what the user reads on the widget.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from difflib import get_close_matches
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from abfm import AbfmError, TriangleMesh
from abfm.mesh import FloatArray
from abfm_viewer import app, viewport
from abfm_viewer.document import Camera
from abfm_viewer.input_events import InputEvents
from abfm_viewer.opengl import OFFSCREEN, Backend, ps
from abfm_viewer.session import Session
from abfm_viewer.ui import Kind, Widget, share_of
from abfm_viewer.window import Window

_CLICKABLE: tuple[Kind, ...] = ("button", "checkbox", "choice", "item", "combo", "section", "menu", "box", "slider")
_SECONDS_TO_OPEN = 120.0
_LONGEST_SCROLL = 60


class DriverError(AbfmError):
    """Something that a user could not have done: no such label, a grey button, a vertex that cannot be seen."""


class Driver:
    """The app with a mouse and a keyboard of ours; a context manager.

    Parameters
    ----------
    mesh : str, Path, TriangleMesh or None
        A mesh, project or result file, or a mesh; by default a bundled one.
    backend : str
        "openGL3_egl" (no screen), "openGL3_glfw" (a window), "openGL_mock" (draws nothing, for logic). A process can
        have only one.
    size : (int, int)
        Of the window, in pixels.

    Attributes
    ----------
    session : Session
        The document and the solver.
    window : Window

    Raises
    ------
    DriverError
        If a process has another backend already.

    Examples
    --------
    >>> with Driver("mesh.off") as gui:
    ...     gui.click("Match")
    ...     gui.wait(lambda s: s.solver.finished, seconds=60)
    ...     gui.drag("time", 0.5)
    ...     gui.screenshot("halfway.png")
    """

    session: Session
    window: Window

    def __init__(
        self,
        mesh: str | Path | TriangleMesh | None = None,
        backend: Backend = OFFSCREEN,
        size: tuple[int, int] = (1600, 1000),
    ) -> None:
        self._mesh, self._backend, self._size = mesh, backend, size
        self._closing = ExitStack()
        self.input = InputEvents(self.frames)

    def __enter__(self) -> Self:
        if ps.is_initialized() and ps.get_render_engine_backend_name() != self._backend:
            raise DriverError(
                f"this process draws with {ps.get_render_engine_backend_name()}, not {self._backend}: "
                "use one backend per process"
            )
        folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory()))
        try:
            self.window = app.open_window(self._mesh, self._backend, self._size, state_folder=folder)
            self._closing.callback(self.window.close)
            self.session = self.window.session
            self.frames(2)
            self.wait(_is_ready, _SECONDS_TO_OPEN)
            self.frames(2)
        except BaseException:
            self._closing.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.input.let_go()
        self._closing.close()

    # Frames

    def frames(self, count: int = 1) -> None:
        """Draw frames, as fast as they come."""
        for _ in range(count):
            self.window.tick()

    def wait(self, condition: Callable[[Session], bool], seconds: float = 60) -> None:
        """Draw frames at the app's rate until a condition on the session holds.

        Raises
        ------
        DriverError
            If it does not hold in time.
        """
        end = time.monotonic() + seconds
        while not condition(self.session):
            if time.monotonic() > end:
                session = self.session
                raise DriverError(
                    f"waited {seconds:g} s in vain; solver: {session.solver.reason or 'running'}, busy: "
                    f"{session.busy or 'no'}, status line: {session.notice.text or 'empty'}, errors: {self.errors}"
                )
            self.window.frame()

    # Widgets

    @property
    def errors(self) -> dict[str, str]:
        """Parts of the window that show an error now."""
        return dict(self.window.errors)

    def labels(self) -> list[str]:
        """Labels of all widgets of the latest frame, in their order."""
        return list(dict.fromkeys(widget.label for widget in self.window.ui.widgets))

    def is_enabled(self, label: str, within: str = "") -> bool:
        """Whether a widget can be used."""
        return self._find(label, within, must_be_enabled=False).enabled

    def text_of(self, label: str, within: str = "", kind: Kind | None = None) -> str:
        """What a box, combo, checkbox ("on", "off") or slider shows."""
        kinds = (kind,) if kind else None
        return self._find(label, within, kinds, must_be_enabled=False).text

    def click(self, label: str, within: str = "") -> None:
        """Click on a widget, or on an entry of a menu, which is opened before.

        Parameters
        ----------
        label
            What the user reads.
        within
            The section, group, menu or dialog, where a label is there twice.

        Raises
        ------
        DriverError
            If there is no such widget, it is grey, or the label is ambiguous.
        """
        self.input.click(*_middle(self._find(label, within, _CLICKABLE)))

    def double_click(self, label: str, within: str = "") -> None:
        """Click twice, quickly."""
        x, y = _middle(self._find(label, within, _CLICKABLE))
        self.input.click(x, y)
        self.input.press()
        self.input.release()

    def menu(self, *labels: str) -> None:
        """Open a menu, its submenus, and click on the last label."""
        for label in labels:
            self.input.click(*_middle(self._find(label, "", ("menu", "item"))))

    def type(self, label: str, text: str, within: str = "") -> None:
        """Replace the text of a box and press Enter."""
        self.input.click(*_middle(self._find(label, within, ("box",)), 0.3))
        self.input.key("ctrl+a")
        if text:
            self.input.write(text)
        else:
            self.input.key("backspace")
        self.input.key("enter")
        self.frames(2)

    def drag(self, label: str, value: float, within: str = "") -> None:
        """Drag a slider to a value in its own units (time: 0 to 2 tau)."""
        widget = self._find(label, within, ("slider",))
        start = _slider_place(widget, float(widget.text)) if widget.text else _middle(widget)
        self.input.drag(start, _slider_place(widget, value))
        self.frames(1)

    def choose(self, label: str, choice: str, within: str = "") -> None:
        """Choose one of a combo's words."""
        self.input.click(*_middle(self._find(label, within, ("combo",)), 0.3))
        self.frames(2)
        self.input.click(*_middle(self._find(choice, label, ("choice",))))
        self.frames(2)

    def check(self, label: str, on: bool = True, within: str = "") -> None:
        """Tick a checkbox, or take the tick away."""
        if (self.text_of(label, within, "checkbox") == "on") != on:
            x0, y0, _, y1 = self._find(label, within, ("checkbox",)).rect
            self.input.click(x0 + (y1 - y0) / 2, (y0 + y1) / 2)

    def key(self, chord: str) -> None:
        """Press a key: "space", "ctrl+z", "left", "enter", "a", ..."""
        try:
            self.input.key(chord)
        except KeyError as error:
            raise DriverError(str(error.args[0])) from None

    # Surfaces

    def pick(self, vertex: int, surface: str = "source", modifiers: Sequence[str] = ("shift",)) -> None:
        """Click on a vertex, numbered as in the mesh file; with Shift, as by default, this moves the active Gaussian.

        A vertex that cannot be seen is turned to the front for the click.

        Raises
        ------
        DriverError
            If it is hidden from there, too, or behind a panel.
        """
        self.drag_on_surface([vertex], surface, modifiers)

    def drag_on_surface(
        self, vertices: Sequence[int], surface: str = "source", modifiers: Sequence[str] = ("shift",)
    ) -> None:
        """Press the mouse on the first vertex and drag it over the others; as `pick` where there is only one."""
        camera = self._turn_to(vertices[0], surface)
        try:
            places = [self._place(vertex, surface) for vertex in vertices]
            self.input.move(*places[0])
            for modifier in modifiers:
                self.input.hold(modifier, True)
            self.input.press()
            for place in places[1:]:
                self.input.move(*place)
            self.input.release()
            for modifier in modifiers:
                self.input.hold(modifier, False)
        finally:
            if camera is not None:
                self.window.scene.frame(self.session, self.window.parts.scene, camera)
        self.frames(2)

    def screenshot(self, path: str | Path) -> None:
        """Write a picture (PNG) of the whole window, panels included."""
        self.frames(2)
        self.window.screenshot(Path(path))

    def _place(self, vertex: int, surface: str) -> tuple[float, float]:
        """Where a vertex is in the window."""
        x, y, _ = viewport.projected(self._position(vertex, surface))[0]
        return float(x), float(y)

    def _position(self, vertex: int, surface: str) -> FloatArray:
        scene = self.window.scene
        if surface not in scene.offsets:
            raise DriverError(f"there is no surface {surface!r}; surfaces are {', '.join(scene.names)}")
        mesh = self.session.mesh
        position: FloatArray = mesh.vertices[mesh.local_vertex(vertex)] + scene.offsets[surface]
        return position

    def _sees(self, vertex: int, surface: str) -> bool:
        left, top, right, bottom = self.window.parts.scene
        x, y = self._place(vertex, surface)
        if not (left < x < right and top < y < bottom):
            return False
        hit = self.window.scene.pick((x, y))
        local = self.session.mesh.local_vertex(vertex)
        return hit is not None and hit.surface == surface and hit.vertex == local

    def _turn_to(self, vertex: int, surface: str) -> Camera | None:
        """Turn the camera so that a vertex can be clicked on; the camera before, or None if it could stay."""
        if self._sees(vertex, surface):
            return None
        scene, mesh = self.window.scene, self.session.mesh
        before = scene.camera()
        for direction in _directions(mesh, mesh.local_vertex(vertex)):
            target = self._position(vertex, surface)
            up = np.eye(3)[1] if abs(direction[1]) < 0.9 else np.eye(3)[2]
            up = up - (up @ direction) * direction
            up /= np.linalg.norm(up)
            for distance in (2.5, 0.8):
                position = target + distance * mesh.length_scale * direction
                camera = Camera(_point(position), _point(target), _point(up), before.angle)
                scene.frame(self.session, self.window.parts.scene, camera)
                self.frames(2)
                if self._sees(vertex, surface):
                    return before
        scene.frame(self.session, self.window.parts.scene, before)
        raise DriverError(f"vertex {vertex} of the {surface} cannot be seen from any side: pick another")

    # Finding

    def _find(
        self, label: str, within: str = "", kinds: Sequence[Kind] | None = None, must_be_enabled: bool = True
    ) -> Widget:
        """A widget in view; sections are opened, menus looked into and the panel scrolled for it."""
        widget = self._seek(label, within, kinds)
        if must_be_enabled and not widget.enabled:
            raise DriverError(f"{label!r} is grey now: it cannot be used")
        return self._scrolled(widget, kinds)

    def _seek(self, label: str, within: str, kinds: Sequence[Kind] | None) -> Widget:
        if (found := self._drawn(label, within, kinds)) is not None:
            return found
        self.frames(2)  # it may have come with the latest change
        if (found := self._drawn(label, within, kinds)) is not None:
            return found
        for section in [w for w in self.window.ui.widgets if w.kind == "section" and w.text == "closed"]:
            self.input.click(*_middle(self._scrolled(section, ("section",)), 0.2))
            if (found := self._drawn(label, within, kinds)) is not None:
                return found
            self.input.click(*_middle(self._scrolled(section, ("section",)), 0.2))
        for menu in [w for w in self.window.ui.widgets if w.kind == "menu" and w.rect[1] < self.window.parts.scene[1]]:
            self.input.click(*_middle(menu))
            if (found := self._drawn(label, within, kinds)) is not None:
                return found
            self.input.key("esc")
        known = self.labels()
        nearest = get_close_matches(label, known, n=3)
        hint = f"; did you mean {' or '.join(map(repr, nearest))}?" if nearest else f"; labels are {', '.join(known)}"
        raise DriverError(f"there is no {label!r}{f' in {within!r}' if within else ''} in the window{hint}")

    def _drawn(self, label: str, within: str, kinds: Sequence[Kind] | None) -> Widget | None:
        """The widget of a label in the latest frame; of several the only enabled one."""
        candidates = [w for w in self.window.ui.widgets if w.label == label and (not kinds or w.kind in kinds)]
        if within:
            candidates = [w for w in candidates if within in w.section.split("/")]
        usable = [w for w in candidates if w.enabled] or candidates
        if len(usable) > 1 and not kinds:
            usable = [w for w in usable if w.kind == "box"] or usable
        if len({w.section for w in usable}) > 1:
            sections = ", ".join(repr(w.section) for w in usable)
            raise DriverError(f"{label!r} is there {len(usable)} times, in {sections}: say within= which")
        return usable[0] if usable else None

    def _scrolled(self, widget: Widget, kinds: Sequence[Kind] | None) -> Widget:
        """The widget after its panel was scrolled so far that its middle can be seen."""
        for _ in range(_LONGEST_SCROLL):
            _, y = _middle(widget)
            left, top, right, bottom = widget.area
            if top <= y <= bottom:
                return widget
            self.input.move((left + right) / 2, (top + bottom) / 2)
            self.input.wheel(1.0 if y < top else -1.0)
            self.frames(1)
            again = self._drawn(widget.label, widget.section.rpartition("/")[2], (widget.kind,))
            if again is None:
                break
            widget = again
        raise DriverError(f"{widget.label!r} cannot be scrolled into view")


def _point(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _is_ready(session: Session) -> bool:
    return session.values("source") is not None and session.values("target") is not None


def _middle(widget: Widget, share: float = 0.5) -> tuple[float, float]:
    left, top, right, bottom = widget.rect
    return left + share * (right - left), (top + bottom) / 2


def _slider_place(widget: Widget, value: float) -> tuple[float, float]:
    """Where on a slider a value is; the grab's half width and two pixels are left free at both ends, as ImGui does."""
    if not widget.low <= value <= widget.high:
        raise DriverError(f"{widget.label} goes from {widget.low:g} to {widget.high:g}, not to {value:g}")
    share = share_of(value, widget.low, widget.high, widget.log)
    left, top, right, bottom = widget.rect
    edge = widget.grab / 2 + 2
    return left + edge + share * (right - left - 2 * edge), (top + bottom) / 2


def _directions(mesh: TriangleMesh, vertex: int) -> FloatArray:
    """Unit vectors to look from at a vertex: its normal first, and others around it."""
    corners = mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    around = np.random.default_rng(0).normal(size=(24, 3))
    tilted = normal + 0.8 * around / np.linalg.norm(around, axis=1)[:, None]
    directions = np.concatenate([normal[None], tilted])
    facing: FloatArray = directions / np.linalg.norm(directions, axis=1)[:, None]
    return facing

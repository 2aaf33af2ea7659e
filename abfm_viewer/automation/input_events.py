"""A mouse and a keyboard for programs: ImGui's input events, with a frame drawn after each."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import polyscope.imgui as imgui

from abfm_viewer.errors import DriverError

Place = tuple[float, float]
"""A point of the window, in pixels."""

_MODIFIERS = {
    "ctrl": (imgui.ImGuiMod_Ctrl, imgui.ImGuiKey_LeftCtrl),
    "shift": (imgui.ImGuiMod_Shift, imgui.ImGuiKey_LeftShift),
    "alt": (imgui.ImGuiMod_Alt, imgui.ImGuiKey_LeftAlt),
}
_ARROWS = ("left", "right", "up", "down")
_KEYS = {"esc": "Escape"} | {name: f"{name.capitalize()}Arrow" for name in _ARROWS}
# seconds within which two clicks are one double click
_NO_SECONDS = 0.0
_ANY_SECONDS = 1e9
_OUTSIDE_PLACE = (-1.0, -1.0)


class InputEvents:
    """Sends what a user's hands would send, and draws `frames` of it; the mouse is at `place`."""

    def __init__(self, frames: Callable[[int], None]) -> None:
        self._frames = frames
        self.place: Place = _OUTSIDE_PLACE

    def move(self, x: float, y: float) -> None:
        self.place = (x, y)
        imgui.GetIO().AddMousePosEvent(x, y)
        self._frames(1)

    def press(self, button: int = 0) -> None:
        """Press a mouse button; 0 is the left one, 1 the right one."""
        imgui.GetIO().AddMouseButtonEvent(button, True)
        self._frames(1)

    def release(self, button: int = 0) -> None:
        imgui.GetIO().AddMouseButtonEvent(button, False)
        self._frames(2)

    def click(self, count: int = 1) -> None:
        """Click where the mouse is; twice is a double click, however slow the frames are."""
        io = imgui.GetIO()
        seconds = io.MouseDoubleClickTime
        for number in range(count):
            io.MouseDoubleClickTime = _ANY_SECONDS if number else _NO_SECONDS
            self.press()
            self.release()
        io.MouseDoubleClickTime = seconds

    def drag(self, *places: Place, steps: int = 3, button: int = 0) -> None:
        """Press a button at the first place, move over the others in steps, and let go."""
        if self.place != places[0]:
            self.move(*places[0])
        self.press(button)
        for start, end in pairwise(places):
            for step in range(1, steps + 1):
                share = step / steps
                x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
                self.move(x, y)
        self.release(button)

    def wheel(self, amount: float) -> None:
        imgui.GetIO().AddMouseWheelEvent(0, amount)
        self._frames(2)

    def write(self, text: str) -> None:
        imgui.GetIO().AddInputCharactersUTF8(text)
        self._frames(2)

    def hold(self, modifier: str, down: bool) -> None:
        """Press or release a modifier with the next frame."""
        for key in _MODIFIERS[modifier]:
            imgui.GetIO().AddKeyEvent(key, down)

    @contextmanager
    def holding(self, modifiers: Sequence[str]) -> Iterator[None]:
        for modifier in modifiers:
            self.hold(modifier, True)
        yield
        for modifier in modifiers:
            self.hold(modifier, False)

    def key(self, chord: str) -> None:
        """Press and release a key such as "space", "ctrl+z" or "a"; DriverError if none is."""
        *modifiers, name = chord.lower().split("+")
        known = _KEYS.get(name, name.upper() if len(name) <= 2 else name.capitalize())
        try:
            code = getattr(imgui, f"ImGuiKey_{known}")
            held = [modifier for modifier in modifiers if _MODIFIERS[modifier]]
        except (AttributeError, KeyError):
            raise DriverError(
                f"there is no key {chord!r}; keys are such as space, ctrl+z, left, enter, f1, a"
            ) from None
        with self.holding(held):
            imgui.GetIO().AddKeyEvent(code, True)
            self._frames(1)
            imgui.GetIO().AddKeyEvent(code, False)
        self._frames(2)

    def let_go(self) -> None:
        """Release everything, take the keyboard from boxes, close menus, move the mouse away."""
        for button in range(3):
            imgui.GetIO().AddMouseButtonEvent(button, False)
        for modifier in _MODIFIERS:
            self.hold(modifier, False)
        self.move(1, 1)
        self.click()
        self.move(*_OUTSIDE_PLACE)

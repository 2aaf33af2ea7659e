"""A simulated mouse and keyboard: input events of ImGui, with frames drawn after each."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import polyscope.imgui as imgui

from abfm_viewer.errors import DriverError

Place = tuple[float, float]  # a point of the window, in pixels

_MODIFIERS = {
    "ctrl": (imgui.ImGuiMod_Ctrl, imgui.ImGuiKey_LeftCtrl),
    "shift": (imgui.ImGuiMod_Shift, imgui.ImGuiKey_LeftShift),
    "alt": (imgui.ImGuiMod_Alt, imgui.ImGuiKey_LeftAlt),
}
_ARROWS = ("left", "right", "up", "down")
_KEYS = {"esc": "Escape"} | {name: f"{name.capitalize()}Arrow" for name in _ARROWS}
# time within which two clicks are a double click
_SECONDS_NEVER = 0.0
_SECONDS_ALWAYS = 1e9
_OUTSIDE_PLACE = (-1.0, -1.0)


class InputEvents:
    """Simulated input of a user with a mouse, whose position is `place`, and a keyboard.

    ``frames`` is a function that draws a number of frames.
    """

    def __init__(self, frames: Callable[[int], None]) -> None:
        self._frames = frames
        self.place: Place = _OUTSIDE_PLACE

    def move(self, x: float, y: float) -> None:
        self.place = (x, y)
        imgui.GetIO().AddMousePosEvent(x, y)
        self._frames(1)

    def press(self, button: int = 0) -> None:
        """Press a mouse button: 0 for the left one, 1 for the right one."""
        imgui.GetIO().AddMouseButtonEvent(button, True)
        self._frames(1)

    def release(self, button: int = 0) -> None:
        imgui.GetIO().AddMouseButtonEvent(button, False)
        self._frames(2)

    def click(self, count: int = 1) -> None:
        """Click at the place of the mouse; two clicks are a double click, also in slow frames."""
        io = imgui.GetIO()
        seconds = io.MouseDoubleClickTime
        for number in range(count):
            io.MouseDoubleClickTime = _SECONDS_ALWAYS if number else _SECONDS_NEVER
            self.press()
            self.release()
        io.MouseDoubleClickTime = seconds

    def drag(self, *places: Place, steps: int = 3, button: int = 0) -> None:
        """Press a button at the first place, move to the others in steps, and release it."""
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
        """Turn the wheel by a number of notches."""
        imgui.GetIO().AddMouseWheelEvent(0, amount)
        self._frames(2)

    def write(self, text: str) -> None:
        imgui.GetIO().AddInputCharactersUTF8(text)
        self._frames(2)

    def set_modifier(self, modifier: str, down: bool) -> None:
        """Press or release a modifier key, which takes effect in the next frame."""
        for key in _MODIFIERS[modifier]:
            imgui.GetIO().AddKeyEvent(key, down)

    @contextmanager
    def holding(self, modifiers: Sequence[str]) -> Iterator[None]:
        for modifier in modifiers:
            self.set_modifier(modifier, True)
        yield
        for modifier in modifiers:
            self.set_modifier(modifier, False)

    def key(self, chord: str) -> None:
        """Press a key such as "space" or "ctrl+z"; raise `DriverError` if there is no such key."""
        *modifiers, name = chord.lower().split("+")
        imgui_name = _KEYS.get(name, name.upper() if len(name) <= 2 else name.capitalize())
        try:
            code = getattr(imgui, f"ImGuiKey_{imgui_name}")
            valid = [modifier for modifier in modifiers if _MODIFIERS[modifier]]
        except (AttributeError, KeyError):
            raise DriverError(
                f"there is no key {chord!r}; examples of keys: space, ctrl+z, left, enter, f1, a"
            ) from None
        with self.holding(valid):
            imgui.GetIO().AddKeyEvent(code, True)
            self._frames(1)
            imgui.GetIO().AddKeyEvent(code, False)
        self._frames(2)

    def release_all(self) -> None:
        """Release buttons and keys, leave text boxes, close menus, and move the mouse away."""
        for button in range(3):
            imgui.GetIO().AddMouseButtonEvent(button, False)
        for modifier in _MODIFIERS:
            self.set_modifier(modifier, False)
        self.move(1, 1)
        self.click()
        self.move(*_OUTSIDE_PLACE)

"""A mouse and a keyboard for programs: ImGui's input events, with frames drawn between them."""

from __future__ import annotations

from collections.abc import Callable

import polyscope.imgui as imgui

_MODIFIERS = {
    "ctrl": (imgui.ImGuiMod_Ctrl, imgui.ImGuiKey_LeftCtrl),
    "shift": (imgui.ImGuiMod_Shift, imgui.ImGuiKey_LeftShift),
    "alt": (imgui.ImGuiMod_Alt, imgui.ImGuiKey_LeftAlt),
}
_KEYS = {"left": "LeftArrow", "right": "RightArrow", "up": "UpArrow", "down": "DownArrow", "esc": "Escape"}


class InputEvents:
    """Sends what a user's hands would send.

    Parameters
    ----------
    frames : callable
        Draws a number of frames.
    """

    def __init__(self, frames: Callable[[int], None]) -> None:
        self._frames = frames

    def move(self, x: float, y: float) -> None:
        """Move the mouse to a place of the window."""
        imgui.GetIO().AddMousePosEvent(x, y)
        self._frames(2)

    def press(self, button: int = 0) -> None:
        """Press a mouse button; 0 is the left one."""
        imgui.GetIO().AddMouseButtonEvent(button, True)
        self._frames(2)

    def release(self, button: int = 0) -> None:
        """Let a mouse button go."""
        imgui.GetIO().AddMouseButtonEvent(button, False)
        self._frames(2)

    def click(self, x: float, y: float) -> None:
        """Move there and click."""
        self.move(x, y)
        self.press()
        self.release()

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 6) -> None:
        """Drag from one place to another."""
        self.move(*start)
        self.press()
        for step in range(1, steps + 1):
            share = step / steps
            self.move(start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
        self.release()

    def wheel(self, amount: float) -> None:
        """Turn the wheel, upwards if positive."""
        imgui.GetIO().AddMouseWheelEvent(0, amount)
        self._frames(2)

    def write(self, text: str) -> None:
        """Type characters."""
        imgui.GetIO().AddInputCharactersUTF8(text)
        self._frames(3)

    def hold(self, modifier: str, down: bool) -> None:
        """Press or release ctrl, shift or alt."""
        for key in _MODIFIERS[modifier]:
            imgui.GetIO().AddKeyEvent(key, down)
        self._frames(1)

    def key(self, chord: str) -> None:
        """Press and release a key such as "space", "ctrl+z", "left" or "a".

        Raises
        ------
        KeyError
            If there is no such key.
        """
        *modifiers, name = chord.lower().split("+")
        known = _KEYS.get(name, name.upper() if len(name) == 1 else name.capitalize())
        try:
            code = getattr(imgui, f"ImGuiKey_{known}")
            held = [modifier for modifier in modifiers if _MODIFIERS[modifier]]
        except (AttributeError, KeyError):
            raise KeyError(f"there is no key {chord!r}; keys are such as space, ctrl+z, left, enter, a") from None
        for modifier in held:
            self.hold(modifier, True)
        imgui.GetIO().AddKeyEvent(code, True)
        self._frames(2)
        imgui.GetIO().AddKeyEvent(code, False)
        for modifier in held:
            self.hold(modifier, False)
        self._frames(2)

    def let_go(self) -> None:
        """Release everything and move the mouse away."""
        for button in range(3):
            imgui.GetIO().AddMouseButtonEvent(button, False)
        for modifier in _MODIFIERS:
            self.hold(modifier, False)
        self.move(-1, -1)

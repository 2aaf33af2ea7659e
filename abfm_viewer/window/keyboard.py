"""Turns keys into actions."""

from functools import cache

import polyscope.imgui as imgui

from abfm_viewer.window.action import Action
from abfm_viewer.window.actions import Actions

_NAMES = {"Left": "LeftArrow", "Right": "RightArrow", "Esc": "Escape"}
_ELSEWHERE = "status line"  # a window without text boxes


class Keyboard:
    """Does what keys stand for, unless they are meant for a text box, a menu or a drag."""

    def __init__(self) -> None:
        self._waiting: Action | None = None
        self._left = ""  # the box that was typed into when a save began: it gets the keyboard back

    def do_pressed(self, actions: Actions) -> None:
        """Do what the keys pressed in this frame stand for: call it at the end of every frame."""
        context = actions.context
        action, self._waiting = self._waiting, None
        if action is None:
            action = _pressed(actions)
            if action is not None and imgui.GetIO().WantTextInput:
                saves = action in (actions.save, actions.save_as)
                self._left = context.ui.active_box if saves else ""
                imgui.SetWindowFocus(_ELSEWHERE)  # in the next frame the box gives what was typed
                action, self._waiting = None, action
        if action is not None:
            action.do()
        elif self._left and not (context.files.saving or self._waiting or context.dialogs.is_open):
            context.ui.focus_next, self._left = self._left, ""


def _pressed(actions: Actions) -> Action | None:
    io = imgui.GetIO()
    if io.KeyAlt or io.KeySuper:
        return None
    if imgui.IsAnyItemActive() and not io.WantTextInput:
        return None
    for action in actions.all:
        if io.WantTextInput and not action.while_typing:
            continue
        for chord in action.chords:
            key, ctrl, shift = _parts(chord)
            held = (ctrl, shift) == (io.KeyCtrl, io.KeyShift)
            if held and imgui.IsKeyPressed(key, action.repeats):
                return action
    return None


@cache
def _parts(chord: str) -> tuple[imgui.ImGuiKey, bool, bool]:
    *modifiers, name = chord.split("+")
    key = getattr(imgui, f"ImGuiKey_{_NAMES.get(name, name)}")
    return key, "Ctrl" in modifiers, "Shift" in modifiers

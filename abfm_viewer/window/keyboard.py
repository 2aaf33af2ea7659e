"""Turns keys into actions."""

from __future__ import annotations

from functools import cache

import polyscope.imgui as imgui

from abfm_viewer.window.actions import Actions
from abfm_viewer.window.shortcuts import SHORTCUTS, Shortcut

_NAMES = {"Left": "LeftArrow", "Right": "RightArrow", "Esc": "Escape"}
_ELSEWHERE = "status line"  # a window without text boxes


class Keyboard:
    """Does what keys stand for, unless they are meant for a text box, a menu or a drag."""

    def __init__(self) -> None:
        self._waiting: Shortcut | None = None

    def do_pressed(self, actions: Actions) -> None:
        """Do what the keys pressed in this frame stand for: call it at the end of every frame."""
        shortcut, self._waiting = self._waiting, None
        if shortcut is None:
            shortcut = _pressed()
            if shortcut is None:
                return
            if imgui.GetIO().WantTextInput:
                imgui.SetWindowFocus(_ELSEWHERE)  # in the next frame the box gives what was typed
                self._waiting = shortcut
                return
        getattr(actions, shortcut.action)()


def _pressed() -> Shortcut | None:
    io = imgui.GetIO()
    anywhere = imgui.ImGuiPopupFlags_AnyPopupId | imgui.ImGuiPopupFlags_AnyPopupLevel
    if io.KeyAlt or io.KeySuper or imgui.IsPopupOpen("", anywhere):
        return None
    if imgui.IsAnyItemActive() and not io.WantTextInput:
        return None
    for shortcut in SHORTCUTS:
        if io.WantTextInput and not shortcut.while_typing:
            continue
        for chord in shortcut.chords:
            key, ctrl, shift = _parts(chord)
            if (ctrl, shift) == (io.KeyCtrl, io.KeyShift) and imgui.IsKeyPressed(key, shortcut.repeats):
                return shortcut
    return None


@cache
def _parts(chord: str) -> tuple[imgui.ImGuiKey, bool, bool]:
    *modifiers, name = chord.split("+")
    key = getattr(imgui, f"ImGuiKey_{_NAMES.get(name, name)}")
    return key, "Ctrl" in modifiers, "Shift" in modifiers

"""Turns keys into actions."""

from __future__ import annotations

from functools import cache

import polyscope.imgui as imgui

from abfm_viewer.actions import Actions
from abfm_viewer.shortcuts import SHORTCUTS

_NAMES = {"Left": "LeftArrow", "Right": "RightArrow", "Esc": "Escape"}


def do_pressed(actions: Actions) -> None:
    """Do what the keys pressed in this frame stand for, unless they are meant for a text box, a menu or a drag."""
    io = imgui.GetIO()
    anywhere = imgui.ImGuiPopupFlags_AnyPopupId | imgui.ImGuiPopupFlags_AnyPopupLevel
    if io.WantTextInput or imgui.IsAnyItemActive() or imgui.IsPopupOpen("", anywhere):
        return
    if io.KeyAlt or io.KeySuper:
        return
    for shortcut in SHORTCUTS:
        for chord in shortcut.chords:
            key, ctrl, shift = _parts(chord)
            if (ctrl, shift) == (io.KeyCtrl, io.KeyShift) and imgui.IsKeyPressed(key, shortcut.repeats):
                getattr(actions, shortcut.action)()
                return


@cache
def _parts(chord: str) -> tuple[imgui.ImGuiKey, bool, bool]:
    *modifiers, name = chord.split("+")
    key = getattr(imgui, f"ImGuiKey_{_NAMES.get(name, name)}")
    return key, "Ctrl" in modifiers, "Shift" in modifiers

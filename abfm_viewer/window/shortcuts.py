"""The keys of the app: one table for the keyboard, the hints in the menus and the list in Help."""

from __future__ import annotations

import sys
from dataclasses import dataclass

_COMMAND = "Cmd" if sys.platform == "darwin" else "Ctrl"


@dataclass(frozen=True)
class Shortcut:
    """An action's keys.

    Attributes
    ----------
    action : str
        Name of a method of `abfm_viewer.window.actions.Actions`.
    chords : tuple of str
        Such as "Ctrl+Shift+S"; Ctrl is Cmd on a Mac.
    does : str
        What it does, for the list.
    group : str
        Its heading in the list.
    repeats : bool
        Whether holding the key does it again and again.
    while_typing : bool
        Whether it holds in a text box, too, which then takes what was typed; others may mean something there.
    """

    action: str
    chords: tuple[str, ...]
    does: str
    group: str
    repeats: bool = False
    while_typing: bool = False

    @property
    def hint(self) -> str:
        """The first chord, as the user's keyboard calls it."""
        return _named(self.chords[0])


SHORTCUTS = (
    Shortcut("open_mesh", ("Ctrl+O",), "open a mesh", "Files", while_typing=True),
    Shortcut("open_project", ("Ctrl+Shift+O",), "open a project or a result", "Files", while_typing=True),
    Shortcut("save", ("Ctrl+S",), "save the project", "Files", while_typing=True),
    Shortcut("save_as", ("Ctrl+Shift+S",), "save the project under another name", "Files", while_typing=True),
    Shortcut("quit", ("Ctrl+Q",), "quit", "Files", while_typing=True),
    Shortcut("undo", ("Ctrl+Z",), "undo", "Changes", repeats=True),
    Shortcut("redo", ("Ctrl+Y", "Ctrl+Shift+Z"), "redo", "Changes", repeats=True),
    Shortcut("match", ("Ctrl+Enter",), "match", "Solver", while_typing=True),
    Shortcut("pause", ("P",), "pause or resume", "Solver"),
    Shortcut("cancel", ("Esc",), "cancel, and keep the best field so far", "Solver"),
    Shortcut("play", ("Space",), "play or pause", "Time"),
    Shortcut("step_back", ("Left",), "a twentieth of tau back", "Time", repeats=True),
    Shortcut("step_on", ("Right",), "a twentieth of tau on", "Time", repeats=True),
    Shortcut("go_to_start", ("Home",), "to time 0", "Time"),
    Shortcut("go_to_end", ("End",), "to tau", "Time"),
    Shortcut("reset_camera", ("R",), "look from the front again", "View"),
    Shortcut("switch_theme", ("L",), "light or dark", "View"),
    Shortcut("show_shortcuts", ("F1",), "this list", "View"),
)
MOUSE = (
    ("drag", "turn the surfaces"),
    ("right drag", "move them"),
    ("wheel", "nearer or farther"),
    ("Shift+click, Shift+drag", "on the source or target: move the active Gaussian"),
    ("Shift+wheel", "wider or narrower Gaussian"),
    ("drop files", "open a mesh, a project or a result"),
)


def hint(action: str) -> str:
    """The keys of an action as a menu shows them; empty where it has none."""
    return next((shortcut.hint for shortcut in SHORTCUTS if shortcut.action == action), "")


def listed() -> list[tuple[str, str]]:
    """The list in Help: rows of keys and what they do; a heading has an empty second part."""
    rows: list[tuple[str, str]] = []
    for group in dict.fromkeys(shortcut.group for shortcut in SHORTCUTS):
        rows.append((group, ""))
        for shortcut in SHORTCUTS:
            if shortcut.group == group:
                rows.append((" or ".join(map(_named, shortcut.chords)), shortcut.does))
    return [*rows, ("Mouse", ""), *MOUSE]


def _named(chord: str) -> str:
    return chord.replace("Ctrl", _COMMAND)

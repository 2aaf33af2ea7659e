"""Keys of all actions, and their names on the keyboard of the user, which depend on the system."""

import sys
from collections.abc import Mapping

COMMAND = "Cmd" if sys.platform == "darwin" else "Ctrl"
"""The key of the commands in menus; ImGui reports Cmd of a Mac as Ctrl."""
AXES = ("x", "y", "z", "-x", "-y", "-z")
KEYS: Mapping[str, str] = {
    "open mesh": "Ctrl+O",
    "open project": "Ctrl+Shift+O",
    "save": "Ctrl+S",
    "save as": "Ctrl+Shift+S",
    "export": "Ctrl+E",
    "quit": "Ctrl+Q",
    "undo": "Ctrl+Z",
    "redo": "Ctrl+Y or Ctrl+Shift+Z",
    "place landmarks": "M",
    "remove landmark": "Delete or Backspace",
    "match": "Ctrl+Enter",
    "match otherwise": "Ctrl+Shift+Enter",
    "pause": "P",
    "cancel": "Esc",
    "smoother": "Up",
    "closer": "Down",
    "play": "Space",
    "back": "Left",
    "forward": "Right",
    "start": "Home",
    "end": "End",
    "search": "Ctrl+K",
    "copy rows": "Ctrl+C",
    "theme": "L",
    "shortcuts": "F1",
    "reset camera": "R",
    "best view": "B",
    "wireframe": "W",
    "flat": "F",
    "hide": "H",
    "show all": "Shift+H",
    **{f"look from {axis}": axis.upper().replace("-", "Shift+") for axis in AXES},
}
"""Keys of actions, such as "Ctrl+S"; ``or`` separates alternatives."""


def hint(action: str) -> str:
    """Return the first shortcut of an action, with the names of keys on the user's keyboard."""
    return KEYS[action].split(" or ")[0].replace("Ctrl", COMMAND)


def with_key(tip: str, action: str) -> str:
    """Return a tooltip with the shortcut of an action: ``Play the frames (Space).``."""
    return f"{tip.removesuffix('.')} ({hint(action)})."

"""Names of keys on the keyboard of the user."""

import sys

COMMAND = "Cmd" if sys.platform == "darwin" else "Ctrl"
"""The key of the commands in menus; ImGui reports Cmd of a Mac as Ctrl."""

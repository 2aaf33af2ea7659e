"""Names of keys as they appear on the keyboard of the user, which depend on the system."""

import sys

COMMAND = "Cmd" if sys.platform == "darwin" else "Ctrl"
"""The key of the commands in menus; ImGui reports Cmd of a Mac as Ctrl."""

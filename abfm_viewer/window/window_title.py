"""The title of a window on a screen, which polyscope sets only before it opens."""

import ctypes
import os
import sys
from contextlib import suppress
from importlib.util import find_spec

from abfm_viewer.scene.opengl import WINDOW, ps


class WindowTitle:
    """Title of the window, set by the GLFW of polyscope, or on Windows by the system."""

    def __init__(self) -> None:
        self._now = ""

    def show(self, text: str) -> None:
        if text == self._now:
            return
        self._now = text
        if ps.get_render_engine_backend_name() == WINDOW:
            # for versions of polyscope that do not export GLFW
            with suppress(OSError, AttributeError):
                _by_windows(text) if sys.platform == "win32" else _by_glfw(text)


def _by_glfw(text: str) -> None:
    """Set the title on Linux and macOS, with the GLFW that polyscope's library exports."""
    found = find_spec("polyscope_bindings")
    if found is None or found.origin is None:
        return
    library = ctypes.CDLL(found.origin)
    current, set_title = library.glfwGetCurrentContext, library.glfwSetWindowTitle
    current.restype, set_title.restype = ctypes.c_void_p, None
    set_title.argtypes = (ctypes.c_void_p, ctypes.c_char_p)
    if window := current():
        set_title(window, text.encode("utf-8", "replace"))


def _by_windows(text: str) -> None:
    """Set the title of all visible windows of this process that have one."""
    user = ctypes.CDLL("user32")

    def visit(number: int, _: int) -> bool:
        window, owner = ctypes.c_void_p(number), ctypes.c_ulong()
        user.GetWindowThreadProcessId(window, ctypes.byref(owner))
        has_title = user.GetWindowTextLengthW(window) > 0
        if owner.value == os.getpid() and has_title and user.IsWindowVisible(window):
            user.SetWindowTextW(window, ctypes.c_wchar_p(text))
        return True

    visitor = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(visit)
    user.EnumWindows(visitor, None)

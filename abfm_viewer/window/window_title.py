"""The title of the real window, which polyscope itself sets only before there is one."""

import ctypes
import os
import sys
from contextlib import suppress
from importlib.util import find_spec

from abfm_viewer.scene.opengl import WINDOW, ps


class WindowTitle:
    """Sets the title where it can: by the GLFW that polyscope brings, on Windows by the system."""

    def __init__(self) -> None:
        self._now = ""

    def show(self, text: str) -> None:
        """Make it the title: costs nothing where it is already."""
        if text == self._now:
            return
        self._now = text
        if ps.get_render_engine_backend_name() == WINDOW:
            # a polyscope that does not tell where its GLFW is
            with suppress(OSError, AttributeError):
                _by_windows(text) if sys.platform == "win32" else _by_glfw(text)


def _by_glfw(text: str) -> None:
    """Linux and macOS: polyscope's own library lets others call the GLFW in it."""
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
    """The visible windows of this process that have a title."""
    user = ctypes.CDLL("user32")

    def visit(number: int, _: int) -> bool:
        window, owner = ctypes.c_void_p(number), ctypes.c_ulong()
        user.GetWindowThreadProcessId(window, ctypes.byref(owner))
        has_title = user.GetWindowTextLengthW(window) > 0
        if owner.value == os.getpid() and has_title and user.IsWindowVisible(window):
            user.SetWindowTextW(window, ctypes.c_wchar_p(text))
        return True

    user.EnumWindows(ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)(visit), None)

"""The one door to polyscope, which would crash without libEGL and not be imported without libX11.

Where the machine cannot draw, importing this file or starting it is a `DrawingError` of one line.
"""

import ctypes
import os
import re
import sys
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from abfm.io import temporary_folder
from abfm.pages import colormaps
from abfm_viewer.errors import DrawingError

if sys.platform == "linux":
    try:
        for _library in ("libX11.so.6", "libGL.so.1", "libEGL.so.1"):
            ctypes.CDLL(_library)
    except OSError as _error:
        raise DrawingError(
            f"cannot draw without OpenGL ({_error}); type: sudo apt-get install libegl1 libgl1"
        ) from None
import polyscope

ps = polyscope
Backend = Literal["auto", "openGL3_glfw", "openGL3_egl", "openGL_mock"]
WINDOW: Backend = "openGL3_glfw"
OFFSCREEN_BACKEND: Backend = "openGL3_egl" if sys.platform == "linux" else "auto"
MATERIAL = "abfm"
"""Has no colour of its own: colours on a surface are those of the colour bar. Materials that come
with polyscope tint highlights, which turns dark red into purple.
"""
_LIGHT = np.array([-0.35, 0.55, 0.76])
_BALL = 256


def spare_a_core() -> None:
    """Let Mesa leave a core to the solver, else stopped at every frame; call before `start`."""
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    os.environ.setdefault("LP_NUM_THREADS", str(max(cores - 2, 0)))


def start(backend: Backend, width: int, height: int, title: str = "abfm") -> None:
    """Start polyscope, or change its size in pixels; a `DrawingError` says why it cannot draw."""
    # GLFW waits for ever for no change
    if not ps.is_initialized() or tuple(ps.get_window_size()) != (width, height):
        ps.set_window_size(width, height)
    if ps.is_initialized():
        return
    has_screen = sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
    if backend == WINDOW and not has_screen:
        raise DrawingError(
            "no screen to open a window on; without one use `abfm match` and `abfm render`"
        )
    ps.set_verbosity(0)
    ps.set_use_prefs_file(False)
    ps.set_display_message_popups(False)
    ps.set_program_name(title)
    try:
        ps.init(backend)
    except RuntimeError as error:
        # polyscope fails once more when Python exits unless something is running
        ps.init("openGL_mock")
        reason = re.sub(r"\[polyscope\]|\[EXCEPTION\]|ERROR:", "", str(error)).strip()
        raise DrawingError(
            f"OpenGL did not start ({reason}); check the screen and the graphics driver"
        ) from None
    with temporary_folder() as folder:
        for name, pixels in colormaps.pictures().items():
            Image.fromarray(pixels).save(f"{folder}/{name}.png")
            ps.load_color_map(colormaps.loaded_name(name), f"{folder}/{name}.png")
        files = [f"{folder}/material {channel}.png" for channel in range(4)]
        for pixels, file in zip(material_pictures(), files, strict=True):
            Image.fromarray(pixels).save(file)
        ps.load_blendable_material(MATERIAL, filenames=files)


def material_pictures() -> NDArray[np.uint8]:
    """Draw a lit ball, four times to blend; 0.9 at most, as polyscope's tone mapping brightens."""
    x, y = np.meshgrid(np.linspace(-1, 1, _BALL), np.linspace(1, -1, _BALL))
    radius = np.maximum(np.hypot(x, y), 1)
    x, y = x / radius, y / radius
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    wrapped = 0.5 + 0.5 * np.tensordot(_LIGHT, [x, y, z], 1)
    brightness = 0.9 * (0.35 + 0.65 * wrapped) * (0.75 + 0.25 * z)
    pictures = np.zeros((4, _BALL, _BALL, 3), dtype=np.uint8)
    for channel in range(3):
        pictures[channel, :, :, channel] = np.round(255 * brightness ** (1 / 2.2))
    return pictures


def clear() -> None:
    """Leave nothing of what was drawn before, nor of how it was seen."""
    ps.remove_all_structures()
    ps.remove_all_slice_planes()
    ps.set_ground_plane_mode("none")
    ps.set_automatically_compute_scene_extents(False)
    ps.set_view_projection_mode("perspective")
    draw_transparency(False)


def draw_transparency(is_needed: bool) -> None:
    """Draw transparent structures as such, only while there are some: a frame then takes 8 passes.

    polyscope begins with it by itself, and does not end it.
    """
    ps.set_transparency_mode("pretty" if is_needed else "none")

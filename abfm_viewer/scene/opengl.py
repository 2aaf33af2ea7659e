"""Import and start of polyscope, which no other module imports.

Without libX11 the import of polyscope fails, and without libEGL it crashes. On a machine that
cannot draw, importing this module or calling `start` raises a `DrawingError` of one line.
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
            f"cannot draw without OpenGL ({_error}); run: sudo apt-get install libegl1 libgl1"
        ) from None
import polyscope

ps = polyscope
Backend = Literal["auto", "openGL3_glfw", "openGL3_egl", "openGL_mock"]
WINDOW: Backend = "openGL3_glfw"
OFFSCREEN_BACKEND: Backend = "openGL3_egl" if sys.platform == "linux" else "auto"
MATERIAL = "abfm"
"""Material without a tint, so that colours on a surface are those of the colour bar.

The materials of polyscope tint highlights, which turns dark red into purple.
"""
_LIGHT = np.array([-0.35, 0.55, 0.76])
_BALL = 256


def reserve_core_for_solver() -> None:
    """Limit the drawing threads of Mesa to all cores except two; call this before `start`.

    Mesa draws without a graphics card. With more threads it would stop the solver in every frame.
    """
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    os.environ.setdefault("LP_NUM_THREADS", str(max(cores - 2, 0)))


def start(backend: Backend, width: int, height: int, title: str = "abfm") -> None:
    """Start polyscope with a window of a size in pixels, or change the size if it is running.

    Raises `DrawingError` if the machine cannot draw.
    """
    # setting the same size again would block GLFW for ever
    if not ps.is_initialized() or tuple(ps.get_window_size()) != (width, height):
        ps.set_window_size(width, height)
    if ps.is_initialized():
        return
    has_screen = sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
    if backend == WINDOW and not has_screen:
        raise DrawingError(
            "there is no screen for a window; use `abfm match` and `abfm render` instead"
        )
    ps.set_verbosity(0)
    ps.set_use_prefs_file(False)
    ps.set_display_message_popups(False)
    ps.set_program_name(title)
    try:
        ps.init(backend)
    except RuntimeError as error:
        # without a running backend polyscope fails again when Python exits
        ps.init("openGL_mock")
        reason = re.sub(r"\[polyscope\]|\[EXCEPTION\]|ERROR:", "", str(error)).strip()
        raise DrawingError(
            f"OpenGL could not be started ({reason}); check the screen and the graphics driver"
        ) from None
    with temporary_folder() as folder:
        for name, pixels in colormaps.colormap_images().items():
            Image.fromarray(pixels).save(f"{folder}/{name}.png")
            ps.load_color_map(colormaps.polyscope_name(name), f"{folder}/{name}.png")
        files = [f"{folder}/material {channel}.png" for channel in range(4)]
        for pixels, file in zip(material_pictures(), files, strict=True):
            Image.fromarray(pixels).save(file, compress_level=1)
        ps.load_blendable_material(MATERIAL, filenames=files)


def material_pictures() -> NDArray[np.uint8]:
    """Return four pictures of a lit ball, (4, H, W, 3), from which polyscope computes shading.

    The brightness of the pictures is at most 0.9 because polyscope's tone mapping brightens them.
    """
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
    """Remove all structures and reset the view and the transparency."""
    ps.remove_all_structures()
    ps.remove_all_slice_planes()
    ps.set_ground_plane_mode("none")
    ps.set_automatically_compute_scene_extents(False)
    ps.set_view_projection_mode("perspective")
    draw_transparency(False)


def draw_transparency(is_needed: bool) -> None:
    """Turn the drawing of transparent structures on or off; if it is on, a frame takes 8 passes.

    polyscope turns it on automatically, but never off.
    """
    ps.set_transparency_mode("pretty" if is_needed else "none")

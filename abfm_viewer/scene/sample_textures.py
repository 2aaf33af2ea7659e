"""The small pictures of the samples as a texture that widgets can draw."""

from typing import Any

import numpy as np
import polyscope.imgui as imgui
from PIL import Image

from abfm_viewer.appearance.samples import PICTURES, part
from abfm_viewer.scene.opengl import ps

_NAME = "pictures of the samples"
Corner = tuple[float, float]


class SampleTextures:
    """Loads the pictures when they are first asked for, and again after polyscope forgot all its structures."""

    def __init__(self) -> None:
        self._buffer: Any = None

    def find(self, name: str) -> tuple[imgui.ImTextureRef, Corner, Corner] | None:
        """A texture, and where in it a sample's picture is; None where nothing is drawn."""
        if ps.get_render_engine_backend_name() == "openGL_mock":
            return None
        if not self._is_there():
            pixels = np.asarray(Image.open(PICTURES).convert("RGBA"), dtype=np.float32) / 255
            ps.add_color_alpha_image_quantity(_NAME, pixels, enabled=False)
            self._buffer = ps.get_quantity_buffer(_NAME, "colors")
        return imgui.ImTextureRef(int(self._buffer.get_texture_native_id())), *part(name)

    def _is_there(self) -> bool:
        if self._buffer is None:
            return False
        try:
            self._buffer.check_ref_still_valid()
        except ValueError:
            return False
        return True

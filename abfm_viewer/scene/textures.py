"""Pictures as textures of ImGui."""

from typing import Any

import numpy as np
import polyscope.imgui as imgui
from PIL import Image

from abfm_viewer.scene.opengl import ps


class Textures:
    """Textures of the window, by names; one that polyscope has removed is loaded again."""

    def __init__(self) -> None:
        self._loaded: dict[str, tuple[Image.Image, Any]] = {}

    def find(self, name: str, picture: Image.Image) -> imgui.ImTextureRef | None:
        """Return the texture of a picture; None if the backend cannot draw.

        A texture replaces the one that had the same name.
        """
        if ps.get_render_engine_backend_name() == "openGL_mock":
            return None
        if not self._is_loaded(name, picture):
            pixels = np.asarray(picture.convert("RGBA"), dtype=np.float32) / 255
            ps.add_color_alpha_image_quantity(name, pixels, enabled=False)
            self._loaded[name] = picture, ps.get_quantity_buffer(name, "colors")
        return imgui.ImTextureRef(int(self._loaded[name][1].get_texture_native_id()))

    def _is_loaded(self, name: str, picture: Image.Image) -> bool:
        try:
            loaded, buffer = self._loaded[name]
            buffer.check_ref_still_valid()
        except (KeyError, ValueError):
            return False
        return loaded is picture

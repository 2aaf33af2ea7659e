"""Streaks of line integral convolution as a texture in colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import FloatArray
from abfm.texels import FloatImage
from abfm.texture_atlas import TextureAtlas
from abfm_viewer.colormaps import ColorRange, linear_table

SHADE = 0.55
"""How much the darkest streak darkens a function's colour, in linear light."""
_BRIGHT, _DARK = 0.85, 0.06  # streaks without a function, in linear light


def streak_texture(
    atlas: TextureAtlas, image: FloatImage, values: FloatArray | None = None, colors: ColorRange | None = None
) -> NDArray[np.float32]:
    """Colours for a texture on `atlas`, whose `corner_coordinates` say where the faces' corners lie in it.

    Parameters
    ----------
    atlas : TextureAtlas
    image : (size, size) array of float32
        As `line_integral_convolution` returns it, from 0 to 1.
    values : (V,) array, optional
        A function whose colours the streaks darken; grey streaks without.
    colors : ColorRange, optional
        Of the function.

    Returns
    -------
    (size, size, 3) array of float32
        In linear light, row 0 at the bottom.
    """
    if values is None or colors is None:
        return np.repeat((_DARK + (_BRIGHT - _DARK) * image)[:, :, None], 3, axis=2)
    share = (atlas.image(values) - colors.low) / (colors.high - colors.low)
    table = linear_table(colors.colormap, 1024).astype(np.float32)
    index = np.clip(share * 1023, 0, 1023).astype(np.int32)
    shade = 1 - SHADE + SHADE * image
    colored: NDArray[np.float32] = table[index] * shade[:, :, None]
    return colored

"""Colouring of streak textures, which line integral convolution produces, by a function."""

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm.numerics.kernels import kernel
from abfm.pages.colormaps import NO_VALUES, linear_table
from abfm.streaks.line_integral import FloatImage
from abfm.streaks.texture_atlas import TextureAtlas
from abfm.types import FloatArray, IndexArray
from abfm_viewer.shown.colored_values import ColoredValues

SHADE = 0.72  # share by which the darkest streak darkens a colour, in linear light
# grey levels of streaks that are not coloured by a function, in linear light
_BRIGHT_LEVEL = 0.85
_DARK_LEVEL = 0.06
_COLORS = 1024


def streak_texture(
    atlas: TextureAtlas,
    image: NDArray[np.float32] | NDArray[np.uint8],
    colored: ColoredValues | None = None,
) -> FloatImage:
    """Return colours (size, size, 3), in linear light, of a texture ``image`` of streaks.

    The image (size, size) is from 0 to 1, or has integers from 0 to 255. Streaks darken the colours
    of values. They are grey without values, and in faces where the values, or those of a vertex,
    are unknown.
    """
    scale = 1 / 255 if image.dtype == np.uint8 else 1.0
    contrast = np.tile([1.0, 0.0, 0.0], (len(atlas.mesh.faces), 1))
    if colored is None:
        table, affine = np.full((1, 3), _BRIGHT_LEVEL), np.zeros((len(atlas.mesh.faces), 3))
        shade = 1 - _DARK_LEVEL / _BRIGHT_LEVEL
        tables, shades = (table, table), (shade, shade * scale)
        return _draw(atlas.texel_faces, (affine, contrast), tables, shades, image)
    values, colors, unknown, of_faces, determined, plain = colored
    if of_faces:
        affine = np.zeros((len(atlas.mesh.faces), 3))
        affine[:, 0] = values
    else:
        affine = atlas.affine(values)
    affine[:, 0] -= colors.low
    affine *= (_COLORS - 1) / (colors.high - colors.low)
    if unknown is not None:
        affine[unknown if of_faces else unknown[atlas.mesh.faces].any(axis=1), 0] = np.nan
    table = np.vstack([linear_table(colors.colormap, _COLORS), np.full((1, 3), NO_VALUES)])
    if determined is not None:
        contrast = atlas.affine(abfm.calculus.averaging(atlas.mesh) @ determined)
    faint = table if plain is None else np.tile(plain, (len(table), 1))
    tables, shades = (table, faint), (SHADE, SHADE * scale)
    return _draw(atlas.texel_faces, (affine, contrast), tables, shades, image)


@kernel
def _draw(
    owners: NDArray[np.int32],
    of_faces: tuple[FloatArray, FloatArray],
    tables: tuple[FloatArray, FloatArray],
    shades: tuple[float, float],
    image: IndexArray,
) -> FloatImage:
    """Return colours of a texture from tables of colours, darkened by an image of streaks.

    ``owners`` are the faces of the texels. For each face, ``of_faces`` has two affine functions
    of the texel, (F, 3). The value of the first is a row of ``tables``, or the last row if it is
    NaN. The second is the contrast of the streaks, from 0 to 1. It is also the share of the first
    table in the colours; the rest is the share of the second table.
    ``shades`` are the darkening where the image is 0, and the brightening per unit of the image.
    This is a compiled kernel because the window draws while it runs.
    """
    table, faint = tables
    last = max(table.shape[0] - 2, 0)
    texture = np.empty((owners.shape[0], owners.shape[1], 3), dtype=np.float32)
    affine, contrast = of_faces
    darkest, slope = shades
    for row in range(owners.shape[0]):
        for column in range(owners.shape[1]):
            face = owners[row, column]
            light, known = 1.0 - darkest + slope * image[row, column], 1.0
            if face >= 0:
                share = (
                    contrast[face, 0]
                    + contrast[face, 1] * (column + 0.5)
                    + contrast[face, 2] * (row + 0.5)
                )
                known = min(max(share, 0.0), 1.0)
                light += (1.0 - known) * (1.0 - light)
            entry = 0
            if face >= 0 and np.isnan(affine[face, 0]):
                entry = table.shape[0] - 1
            elif face >= 0:
                share = (
                    affine[face, 0]
                    + affine[face, 1] * (column + 0.5)
                    + affine[face, 2] * (row + 0.5)
                )
                entry = int(min(max(share, 0.0), last))
            for channel in range(3):
                color = known * table[entry, channel] + (1.0 - known) * faint[entry, channel]
                texture[row, column, channel] = light * color
    return texture

"""Streaks along a field: grey textures, and those in the colours of a function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm.types import FloatArray
from abfm_viewer import shown
from abfm_viewer.appearance.colormaps import ColorRange
from abfm_viewer.shown.field_parts import Field

_LEAST_TEXELS_PER_FACE = 12
_MOST_TEXELS = 16384
_PHASES = 16  # of moving streaks that are computed; those between are blended
_EXACT = 1e-6


@dataclass(frozen=True, eq=False)
class Streaks:
    """Grey textures (P, size, size), from 0 to 255, with streaks along a field, and the atlas that
    says what is where.

    More than one show phases of the streaks' way along the field.
    """

    field: Field
    atlas: abfm.streaks.TextureAtlas
    images: NDArray[np.uint8]

    def at(self, phase: float) -> NDArray[np.uint8]:
        """The texture of a phase from 0 to 1."""
        place = phase % 1 * len(self.images)
        before, share = int(place), place % 1
        first: NDArray[np.uint8] = self.images[before % len(self.images)]
        if share < _EXACT or len(self.images) == 1:
            return first
        second = self.images[(before + 1) % len(self.images)]
        blended: NDArray[np.float32] = np.float32(1 - share) * first + np.float32(share) * second
        return (blended + np.float32(0.5)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Texture:
    """Colours (size, size, 3), linear light, and where the faces' corners lie in them, (3F, 2)."""

    streaks: Streaks
    colors: abfm.streaks.FloatImage
    corners: FloatArray


def convolved(field: Field, size: int, fade: bool, moving: bool) -> Streaks:
    """Streaks along a field, in textures at least `size` wide, more on meshes with many faces."""
    size = min(
        max(size, int(np.sqrt(_LEAST_TEXELS_PER_FACE * len(field.mesh.faces)))), _MOST_TEXELS
    )
    phases = np.arange(_PHASES) / _PHASES if moving else None
    atlas, images = abfm.streaks.line_integral_convolution(
        field.mesh, field.velocity, size=size, fade=fade, phase=phases
    )
    steps = [
        (255 * image + np.float32(0.5)).astype(np.uint8) for image in images.reshape(-1, size, size)
    ]
    return Streaks(field, atlas, np.stack(steps))


def coloured(streaks: Streaks, phase: float, values: FloatArray, colors: ColorRange) -> Texture:
    """Streaks at a phase in the colours of a function (V,)."""
    texture = shown.streak_texture(streaks.atlas, streaks.at(phase), values, colors)
    return Texture(streaks, texture, streaks.atlas.corner_coordinates)

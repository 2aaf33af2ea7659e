"""How light falls on surfaces: without colour of its own, so that colours on a surface are those of the colour bar.

polyscope takes a material as four pictures of a lit ball, one for each primary colour and one for black, and blends
them; materials that come with it tint highlights, which turns dark red into purple.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from PIL import Image

NAME = "abfm"
_LIGHT = np.array([-0.35, 0.55, 0.76])
_SIZE = 256


def brightness() -> NDArray[np.float64]:
    """Reflected light of a white ball seen from the front, (size, size); outside of the ball that of its rim.

    At most 0.9: polyscope's tone mapping brightens, and the light grey of an empty surface should stay below white.
    """
    x, y = np.meshgrid(np.linspace(-1, 1, _SIZE), np.linspace(1, -1, _SIZE))
    radius = np.maximum(np.hypot(x, y), 1)
    x, y = x / radius, y / radius
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    wrapped = 0.5 + 0.5 * np.tensordot(_LIGHT, [x, y, z], 1)
    return 0.9 * (0.35 + 0.65 * wrapped) * (0.75 + 0.25 * z)


@contextmanager
def image_files() -> Iterator[list[str]]:
    """Paths of the four pictures (red, green, blue, black), which last as long as the context."""
    lit = np.round(255 * brightness() ** (1 / 2.2)).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for channel in range(4):
            picture = np.zeros((_SIZE, _SIZE, 3), dtype=np.uint8)
            if channel < 3:
                picture[:, :, channel] = lit
            paths.append(f"{folder}/{channel}.png")
            Image.fromarray(picture).save(paths[-1])
        yield paths

"""How light falls on surfaces: without colour of its own, so that colours on a surface are those of
the colour bar.

polyscope takes a material as four pictures of a lit ball, one for each primary colour and one for
black, and blends them; materials that come with it tint highlights, which turns dark red into
purple.
"""

import numpy as np
from numpy.typing import NDArray

NAME = "abfm"
_LIGHT = np.array([-0.35, 0.55, 0.76])
_SIZE = 256


def pictures() -> NDArray[np.uint8]:
    """Return pictures for red, green, blue and black; outside of the ball is the light of its rim.

    At most 0.9 is reflected: polyscope's tone mapping brightens, and the light grey of an empty
    surface should stay below white.
    """
    x, y = np.meshgrid(np.linspace(-1, 1, _SIZE), np.linspace(1, -1, _SIZE))
    radius = np.maximum(np.hypot(x, y), 1)
    x, y = x / radius, y / radius
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    wrapped = 0.5 + 0.5 * np.tensordot(_LIGHT, [x, y, z], 1)
    brightness = 0.9 * (0.35 + 0.65 * wrapped) * (0.75 + 0.25 * z)
    pictures = np.zeros((4, _SIZE, _SIZE, 3), dtype=np.uint8)
    for channel in range(3):
        pictures[channel, :, :, channel] = np.round(255 * brightness ** (1 / 2.2))
    return pictures

"""A camera at a distance that fills the picture."""

import numpy as np

from abfm.types import FloatArray
from abfm_viewer.document.document import Camera, Front, triple


def fitted(vertices: FloatArray, front: Front, aspect: float | None, angle: float, margin: float) -> Camera:
    """The nearest camera in a direction that sees all vertices (V, 3).

    Its aspect is by default the shape's own, its angle is in degrees, and the margin that stays free on each side is a
    share of what the vertices take.
    """
    x, y, z = front.axes @ vertices.T
    middle = np.array([(values.min() + values.max()) / 2 for values in (x, y, z)])
    half_width, half_height = np.abs(x - middle[0]), np.abs(y - middle[1])
    if aspect is None:
        aspect = float(half_width.max() / half_height.max())
    extent = np.maximum(half_width / aspect, half_height) * (1 + 2 * margin)
    distance = float((z - middle[2] + extent / np.tan(np.radians(angle / 2))).max())
    target = middle @ front.axes
    return Camera(triple(target + distance * np.array(front.direction)), triple(target), front.up, angle, aspect)

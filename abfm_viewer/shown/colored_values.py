"""Values of a surface with their colours."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.pages.colormaps import ColorRange
from abfm.types import BoolArray, FloatArray

# of surfaces without values, in linear light
PLAIN_COLORS = {"light": (0.8, 0.81, 0.83), "dark": (0.3, 0.3, 0.32)}


class ColoredValues(NamedTuple):
    """Values of a surface with their colours; grey where the mask ``unknown`` is true.

    Streaks over the values are faint where the share ``determined`` (F,) of their field is small.
    The colours are then mixed with the colour ``plain``, in linear light, if it is not None.
    """

    values: NDArray[np.floating]  # (V,), or (F,) if ``of_faces``
    colors: ColorRange
    unknown: BoolArray | None = None
    of_faces: bool = False
    determined: FloatArray | None = None
    plain: tuple[float, float, float] | None = None

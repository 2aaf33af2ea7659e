"""Values of a surface with their colours."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.pages.colormaps import ColorRange
from abfm.types import BoolArray, FloatArray


class ColoredValues(NamedTuple):
    """Values of a surface with their colours; grey where the mask ``unknown`` is true.

    Streaks over the values are faint where the share ``determined`` (F,) of their field is small.
    """

    values: NDArray[np.floating]  # (V,), or (F,) if ``of_faces``
    colors: ColorRange
    unknown: BoolArray | None = None
    of_faces: bool = False
    determined: FloatArray | None = None

"""The simplest interpolation: source fades out while target fades in, and nothing moves."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.types import FloatArray


def linear_blend(f: ArrayLike, g: ArrayLike, t: float, tau: float = 1.0) -> FloatArray:
    """``(1 - t / tau) f + (t / tau) g``, in the shape of ``f`` and ``g``: ``f`` at time 0, ``g`` at time ``tau``."""
    return (1 - t / tau) * np.asarray(f, dtype=np.float64) + t / tau * np.asarray(g, dtype=np.float64)

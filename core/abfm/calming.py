"""Fields that come from a coarser mesh, smoothed as little as keeps their discrete flow calm on the finer one.

Where the normal parts of a field jump over edges the discrete flow grows, on meshes of thin triangles beyond bounds.
Smoothing on the scale of an edge, by the norm of first order, takes most of the jumps away.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from abfm.energy import MatchingEnergy
from abfm.mesh import FloatArray
from abfm.regularizer import Regularizer

_WORSE, _GROWN = 2.0, 0.4  # times the mismatch on the coarser mesh, and more: not the field's doing
_SCALES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # edges over which fields are smoothed


def calmed(
    energy: MatchingEnergy, x: FloatArray, mismatch: float, between: Callable[[], None] = lambda: None
) -> FloatArray:
    """Fields that carry the source about as well as they did on a coarser mesh, or else the best of those tried.

    Parameters
    ----------
    energy : MatchingEnergy
        On the finer mesh.
    x : (N, F, 2) array
        Frame coefficients there.
    mismatch : float
        Relative mismatch on the coarser mesh.
    between : callable, optional
        Called before each try; what it raises ends the work.

    Returns
    -------
    (N, F, 2) array
        Zero where no flow stays finite.
    """
    area = 1 / len(energy.mesh.vertices)
    calm, least = np.zeros_like(x), np.inf
    for edges in _SCALES:
        between()
        tried = x
        if edges:
            smooth = Regularizer(energy.mesh, area * edges**2)
            tried = np.stack([smooth.inverse((smooth.mass * v.ravel()).reshape(v.shape)) for v in x])
        found = energy.relative_mismatch(energy.advected(tried))
        if found < least:
            calm, least = tried, found
        if found <= _WORSE * mismatch + _GROWN:  # false if not finite
            break
    return calm

"""Fields that come from a coarser mesh, smoothed as little as keeps their discrete flow calm on the
finer one.

Where the normal parts of a field jump over edges the discrete flow grows, on meshes of thin
triangles beyond bounds. Smoothing on the scale of an edge, by the norm of first order, takes most
of the jumps away.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from abfm.matching.objective.regularizer import Regularizer
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

Point = TypeVar("Point")
_WORSE, _GROWN = 2.0, 0.4  # times the mismatch on the coarser mesh, and more: not the field's doing
_SCALES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # edges over which fields are smoothed


def calmed(
    mesh: TriangleMesh,
    x: FloatArray,
    mismatch: float,
    evaluate: Callable[[FloatArray], tuple[Point, float]],
) -> tuple[FloatArray, Point]:
    """Fields that carry the source about as well as they did on a coarser mesh, or else the best of
    those tried.

    Parameters
    ----------
    mesh : TriangleMesh
        The finer one, scaled to unit area.
    x : (N, F, 2) array
        Frame coefficients there.
    mismatch : float
        Relative mismatch on the coarser mesh.
    evaluate : callable
        What is known of fields on the finer mesh, and the relative mismatch that they leave; what
        it raises ends the work.

    Returns
    -------
    (N, F, 2) array
        Zero where no flow stays finite.
    Point
        What is known of them.
    """
    area = 1 / len(mesh.vertices)
    calm, least = None, np.inf
    for edges in _SCALES:
        tried = x
        if edges:
            smooth = Regularizer(mesh, area * edges**2)
            tried = np.stack(
                [smooth.inverse((smooth.mass * v.ravel()).reshape(v.shape)) for v in x]
            )
        point, found = evaluate(tried)
        if found < least:
            calm, least = (tried, point), found
        if found <= _WORSE * mismatch + _GROWN:  # false if not finite
            break
    return calm or (np.zeros_like(x), evaluate(np.zeros_like(x))[0])

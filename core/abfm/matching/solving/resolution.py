"""How many edges of a mesh a function's features span: whether advection on this mesh can carry
it.
"""

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.operators import edge_areas, edge_lengths
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

RESOLVED = 5.0
"""Edges per width below which advection over a quarter of a body (half of sqrt(area)) is off by
several percent.
"""
_SHARE = 0.75  # of the variation lies on edges along which the function changes less
_CONSTANT = 1e-9  # a range so small against the values is rounding


def resolution(mesh: TriangleMesh, f: ArrayLike) -> float:
    """Return how many edges the narrow features of a function span; of several channels the least,
    inf for constants.

    Half the function's range over its change along an edge: over that which the function exceeds on
    a quarter of its variation ``int |grad f|^2``. That makes it the width over the edge length, to
    within 15 percent, of a Gaussian ``exp(-r^2 / (2 width^2))`` on an even mesh, if it is at least
    one edge wide. A jump spans half an edge. In the plane a narrow bump varies as much as a wide
    one of the same height, so that it is not overlooked beside that; bumps that are much lower do
    not count. Only changes along edges matter: adding constants, scaling the function and scaling
    the mesh change nothing.

    Parameters
    ----------
    f : (V,) or (V, C) array

    Raises
    ------
    FunctionError
        If ``f`` does not fit the mesh.
    """
    return min(_of_channel(mesh, channel) for channel in channels(mesh, f, "f"))


def narrowest(functions: FunctionTerm) -> float:
    """`resolution` of source and target, of the channels that count."""
    counting = functions.weights > 0
    return resolution(
        functions.mesh, np.concatenate([functions.source[counting], functions.target[counting]]).T
    )


def _of_channel(mesh: TriangleMesh, f: FloatArray) -> float:
    span = float(np.ptp(f))
    if span <= _CONSTANT * np.abs(f).max():
        return np.inf
    start, end = mesh.edges.T
    changes = np.abs(f[end] - f[start]) / span
    variation = edge_areas(mesh) * (changes / edge_lengths(mesh)) ** 2
    order = np.argsort(changes, kind="stable")
    below = np.cumsum(variation[order])
    return 0.5 / float(changes[order[np.searchsorted(below, _SHARE * below[-1])]])

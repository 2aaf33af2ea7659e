"""Functions on the subdivision of their mesh: evaluated anew by their text, or interpolated."""

import numpy as np

from abfm.errors import AbfmError
from abfm.functions.files import Permuted, ValuesFile
from abfm.functions.local_shape import Curvature
from abfm.functions.spec import function, functions_in, parse
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import interpolated, refined
from abfm.types import FloatArray

_DIFFERENCE_MAX = 0.5
"""Of its norm: what differs by more at the vertices that stay is another function, such as another
one with the same eigenvalue; coarse distances are off by a tenth."""


def on_subdivision(mesh: TriangleMesh, values: FloatArray, spec: str = "") -> FloatArray:
    """Return a function (V,) on the subdivided mesh, (V + E,): by its spec, if it has one that
    means the same there, else interpolated.
    """
    fine = refined(mesh, 1)
    if spec and _is_meaningful(spec):
        try:
            anew = function(fine, spec)
        except AbfmError:
            return interpolated(mesh, values)
        if np.linalg.norm(anew[: len(values)] - values) <= _DIFFERENCE_MAX * np.linalg.norm(values):
            return anew
    return interpolated(mesh, values)


def _is_meaningful(spec: str) -> bool:
    """Return whether it needs no file, and no curvature, which is 0 at middles of flat edges."""
    try:
        parts = functions_in(parse(spec))
    except AbfmError:
        return False
    return not any(isinstance(part, ValuesFile | Permuted | Curvature) for part in parts)

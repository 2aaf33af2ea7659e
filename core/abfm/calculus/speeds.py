"""The speed above which a part of a field counts as fast."""

import numpy as np

from abfm.calculus.operators import face_areas
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

# the largest speeds (outliers), on this share of the area, count as the next lower speed
_OUTLIER_AREA_SHARE = 0.001
_FAST_NORM_SHARE = 0.4  # share of the squared norm on the faces that count as fast


def fast_speed(mesh: TriangleMesh, speed: FloatArray) -> float:
    """Return the speed above which speeds (F,) count as fast; 0 if all are 0.

    The faces with higher speeds contribute 40% of the squared L2 norm of the field, wherever they
    are on the surface. Outliers, which occur on slivers, are first reduced to the next lower speed.
    """
    descending = np.argsort(-speed, kind="stable")
    areas = face_areas(mesh)[descending] / mesh.length_scale**2
    regular = min(int(np.searchsorted(np.cumsum(areas), _OUTLIER_AREA_SHARE)), len(speed) - 1)
    most = float(speed[descending[regular]]) or float(speed.max())
    if not most:
        return 0.0
    norms = np.cumsum(areas * np.minimum(speed[descending] / most, 1) ** 2)
    return float(min(speed[descending[np.searchsorted(norms, _FAST_NORM_SHARE * norms[-1])]], most))

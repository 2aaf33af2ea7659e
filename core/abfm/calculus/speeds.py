"""Which speeds of a field count as fast."""

import numpy as np

from abfm.calculus.operators import face_areas
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

# of the area: speeds that no more of it has count as the next lower ones
_OUTLIER_AREA_SHARE = 0.001
_FAST_NORM_SHARE = 0.4  # of the squared norm: what as much of it exceeds is fast


def fast_speed(mesh: TriangleMesh, speed: FloatArray) -> float:
    """Return what of speeds (F,) counts as fast: faces that are faster have a good part of the
    field's squared norm, wherever that is on the surface. Those of slivers, which run wild, count
    as their lower neighbours'; 0 if all is still.
    """
    descending = np.argsort(-speed, kind="stable")
    areas = face_areas(mesh)[descending] / mesh.length_scale**2
    tame = min(int(np.searchsorted(np.cumsum(areas), _OUTLIER_AREA_SHARE)), len(speed) - 1)
    most = float(speed[descending[tame]]) or float(speed.max())
    if not most:
        return 0.0
    norms = np.cumsum(areas * np.minimum(speed[descending] / most, 1) ** 2)
    return float(min(speed[descending[np.searchsorted(norms, _FAST_NORM_SHARE * norms[-1])]], most))

"""What the discrete flow carries less far than flow lines do, which a field that only it has seen
makes up for: such a field is too fast, by some percent where a wave has sixteen edges.
"""

import numpy as np

from abfm.calculus.operators import averaging, gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.surface_points import SurfacePoints
from abfm.matching.objective.matching_energy import MatchingEnergy, advect_functions
from abfm.sequences.noise import means_of_neighbours
from abfm.types import FloatArray

_SMOOTHING_STEPS = 4  # times, halfway to the mean of neighbours


def advection_defect(energy: MatchingEnergy, field: FloatArray) -> FloatArray:
    """Return what the discrete flow of a field (F, 2) carries, less what its flow lines do, (C, V);
    0 where they lead over too many faces.

    It is the smooth part of it: noise goes along flow lines, but hardly with the discrete flow, and
    what differs between neighbours is where in its face a flow line ends.
    """
    mesh, x, source = energy.mesh, field[None], energy.functions.source
    try:
        flow = ContinuousFlow(mesh, to_ambient(mesh, x), energy.parameters.tau)
    except ParameterError:
        return np.zeros_like(source)
    apart = advect_functions(energy.flow, x, source) - quadratic_values(flow.origins(), source)
    for _ in range(_SMOOTHING_STEPS):
        apart = 0.5 * (apart + means_of_neighbours(mesh, apart))
    return apart


def quadratic_values(points: SurfacePoints, functions: FloatArray) -> FloatArray:
    """Evaluate functions (C, V) at points, (C, P), as their slopes at vertices say that they bend
    along edges: linear ones inside faces would flatten a wave wherever a flow line ends in a face.

    With ``l`` the barycentric weights, ``sum_i l_i f_i - 1/2 sum_ij l_i l_j (df_j - df_i)(x_j -
    x_i)`` over the edges, which is exact where ``f`` is quadratic and the slopes are its own.
    """
    mesh, weights = points.mesh, points.barycentric
    corners = mesh.faces[points.faces]
    places = mesh.vertices[corners]  # (P, 3, 3)
    found = np.ascontiguousarray(points.pull_back(functions.T).T)
    for f, values in zip(functions, found, strict=True):
        slopes = averaging(mesh) @ to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
        at_corners = slopes[corners]
        for i, j in ((0, 1), (1, 2), (2, 0)):
            changes = at_corners[:, j] - at_corners[:, i]
            bends = np.einsum("px,px->p", changes, places[:, j] - places[:, i])
            values -= 0.5 * weights[:, i] * weights[:, j] * bends
    return found

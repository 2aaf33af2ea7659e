"""What flow lines say of a field: what it leaves, and what its map does to areas and shapes."""

import numpy as np

from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.distortion import distortion_of_flow
from abfm.maps.surface_points import vertex_points
from abfm.matching.judging.verification import FEW, estimate
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray


def measured(energy: MatchingEnergy, fields: FloatArray) -> dict[str, float]:
    """Return what flow lines say of fields (N, F, 3), for a `PathStep`; above `FEW` vertices by so
    many. AbfmError if they lead over too many faces.
    """
    verified, folded = estimate(energy, fields)
    mesh, faces = energy.mesh, np.arange(len(energy.mesh.faces))
    if len(mesh.vertices) > FEW:
        faces = np.linspace(0, len(faces) - 1, FEW // 2).astype(np.int64)
    area, shape = _stretches(mesh, fields, energy.parameters.tau, faces)
    return {
        "verified_mismatch": verified,
        "folded": folded,
        "log2_area": area,
        "log2_shape": shape,
    }


def _stretches(
    mesh: TriangleMesh, fields: FloatArray, tau: float, faces: IntArray
) -> tuple[float, float]:
    """Return `log2_area` and `log2_shape` over some faces (S,)."""
    flow = ContinuousFlow(mesh, fields, tau)
    asked, corners = np.unique(mesh.faces[faces], return_inverse=True)
    points = flow.destinations(vertex_points(mesh, asked))[corners.ravel()]
    found = distortion_of_flow(mesh, faces, points, flow.destinations)
    return found.log2_area.mean, found.log2_shape.mean

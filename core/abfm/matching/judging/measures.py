"""What flow lines say of a field: what it leaves, and what its map does to areas and shapes."""

import numpy as np

from abfm.calculus.operators import face_areas
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.distortion import distortion
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
    asked = np.unique(mesh.faces[faces])
    positions = mesh.vertices.copy()
    carried = ContinuousFlow(mesh, fields, tau).destinations(vertex_points(mesh, asked))
    positions[asked] = carried.positions
    found, areas = distortion(mesh, positions), face_areas(mesh)[faces]
    # a face that collapsed counts as one that is hardly there
    least = np.finfo(float).tiny
    ratios = np.maximum([found.area[faces], 1 / found.conformal[faces]], least)
    area, shape = np.abs(np.log2(ratios)) @ areas / areas.sum()
    return float(area), float(shape)

"""Measurements of fields along flow lines: the residual and the distortion of the map."""

import numpy as np

from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.distortion import folded_shares, log2_changes
from abfm.maps.surface_points import vertex_points
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.settings import SETTINGS
from abfm.matching.terms.functions import FunctionTerm
from abfm.matching.terms.landmarks import residual_of_errors
from abfm.types import BoolArray, FloatArray, IntArray


def flow_line_measures(energy: MatchingEnergy, fields: FloatArray) -> dict[str, float]:
    """Measure fields (N, F, 3) along flow lines; return numbers by attribute of `PathStep`.

    On meshes with more than 20,000 vertices, they are estimated from about that number of vertices.
    The dictionary is empty if flow lines cross too many faces. The distortion is that of the map
    from each vertex to the origin of its value. It is computed from the triangles between mapped
    vertices.
    """
    mesh, functions = energy.mesh, energy.functions
    faces = np.arange(len(mesh.faces))
    vertices_max = SETTINGS.flow_line_vertices_max
    if len(mesh.vertices) > vertices_max:
        faces = np.linspace(0, len(faces) - 1, vertices_max // 2).astype(np.int64)
    try:
        flow = ContinuousFlow(mesh, fields, energy.parameters.tau)
    except ParameterError:
        return {}
    residual, places = flow_line_residual(functions, flow, faces)
    if energy.landmarks is not None:
        ends = flow.destinations(energy.landmarks.points())
        residual = max(residual, residual_of_errors(energy.landmarks.errors(ends)))
    area, area_95, shape = log2_changes(mesh, faces, places)
    return {
        "verified_residual": residual,
        "folded": folded_shares(mesh, flow.origins, faces, places, SETTINGS.cut_faces_max)[0],
        "log2_area": area,
        "log2_shape": shape,
        "log2_area_95": area_95,
    }


def advect_along_flow_lines(
    energy: MatchingEnergy, x: FloatArray, where: BoolArray | None = None
) -> FloatArray:
    """Return the source (C, V) advected along flow lines of fields with coefficients (N, F, 2).

    ``where`` (V,) selects the vertices at which the source is advected, by default all of them. The
    others keep the values of the source. Raise ParameterError if flow lines cross too many faces.
    """
    mesh, source = energy.mesh, energy.functions.source
    flow = ContinuousFlow(mesh, to_ambient(mesh, x), energy.parameters.tau)
    selected = np.arange(len(mesh.vertices)) if where is None else np.flatnonzero(where)
    advected = source.copy()
    points = flow.origins(vertex_points(mesh, selected))
    advected[:, selected] = points.pull_back(source.T).T
    return advected


def flow_line_residual(
    functions: FunctionTerm, flow: ContinuousFlow, faces: IntArray
) -> tuple[float, FloatArray]:
    """Return the residual along flow lines at the vertices of the faces with indices (S,).

    Also return the points (S, 3, 3) that the flow moves to the corners of these faces.
    """
    mesh, source, mask = functions.mesh, functions.source, functions.mask
    requested, corners = np.unique(mesh.faces[faces], return_inverse=True)
    points = flow.origins(vertex_points(mesh, requested))
    weight = np.zeros(len(mesh.vertices))
    weight[requested] = 1.0 if mask is None else mask[requested]
    advected = np.zeros_like(source)
    advected[:, requested] = points.pull_back(source.T).T
    residual = functions.with_mask(weight).residual(advected)
    return residual, points.positions[corners.reshape(-1, 3)]

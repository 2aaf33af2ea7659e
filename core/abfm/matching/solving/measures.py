"""Measurements of a field along flow lines: its residual, and the distortion of its map."""

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
    """Return the measurements of fields (N, F, 3) for a `PathStep`.

    On meshes above 20,000 vertices they are those of as many. They are left out if flow lines
    cross too many faces.

    Stretches are those of the map of each vertex to where its value came from, by the triangles
    between mapped vertices.
    """
    mesh, functions = energy.mesh, energy.functions
    faces = np.arange(len(mesh.faces))
    most = SETTINGS.flow_line_vertices_max
    if len(mesh.vertices) > most:
        faces = np.linspace(0, len(faces) - 1, most // 2).astype(np.int64)
    try:
        flow = ContinuousFlow(mesh, fields, energy.parameters.tau)
    except ParameterError:
        return {}
    left, places = flow_line_residual(functions, flow, faces)
    if energy.landmarks is not None:
        ends = flow.destinations(energy.landmarks.points())
        left = max(left, residual_of_errors(energy.landmarks.errors(ends)))
    area, area_95, shape = log2_changes(mesh, faces, places)
    return {
        "verified_residual": left,
        "folded": folded_shares(mesh, flow.origins, faces, places, SETTINGS.cut_faces_max)[0],
        "log2_area": area,
        "log2_shape": shape,
        "log2_area_95": area_95,
    }


def advect_along_flow_lines(
    energy: MatchingEnergy, x: FloatArray, where: BoolArray | None = None
) -> FloatArray:
    """Return the source (C, V) carried along flow lines of frame coefficients (N, F, 2).

    ``where`` (V,) selects the vertices, all by default; the others keep the values of the source.
    ParameterError if flow lines cross too many faces.
    """
    mesh, source = energy.mesh, energy.functions.source
    flow = ContinuousFlow(mesh, to_ambient(mesh, x), energy.parameters.tau)
    selected = np.arange(len(mesh.vertices)) if where is None else np.flatnonzero(where)
    carried = source.copy()
    points = flow.origins(vertex_points(mesh, selected))
    carried[:, selected] = points.pull_back(source.T).T
    return carried


def flow_line_residual(
    functions: FunctionTerm, flow: ContinuousFlow, faces: IntArray
) -> tuple[float, FloatArray]:
    """Return what flow lines leave at the vertices of some faces (S,), by number, and where the
    values of their corners came from, (S, 3, 3).
    """
    mesh, source, mask = functions.mesh, functions.source, functions.mask
    asked, corners = np.unique(mesh.faces[faces], return_inverse=True)
    points = flow.origins(vertex_points(mesh, asked))
    weight = np.zeros(len(mesh.vertices))  # nothing where nobody asked
    weight[asked] = 1.0 if mask is None else mask[asked]
    found = np.zeros_like(source)
    found[:, asked] = points.pull_back(source.T).T
    left = functions.with_mask(weight).residual(found)
    return left, points.positions[corners.reshape(-1, 3)]

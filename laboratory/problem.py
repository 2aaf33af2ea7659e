"""The problem of Fig. 3 on a sphere: one wide bump on the equator splits into two narrow ones."""

from dataclasses import replace

import numpy as np
import trimesh

from abfm.matching.problem import Problem
from abfm.mesh import TriangleMesh
from abfm.parameters import PAPER, Parameters
from abfm.types import FloatArray

PARAMETERS = Parameters(
    **PAPER,
    tau=2.0,
    alpha=1e3,
    beta=1e-5,
    sigma=1e-4,
    substeps=40,
    quadrature=10,
    cooling_stages=1,
    tolerance=0.0,
)
"""The row of Fig. 3 in Table 1, sigma constant, and no end but the iteration limit."""

COOLED = replace(PARAMETERS, cooling_stages=Parameters().cooling_stages)

_SOURCE_WIDTH, _TARGET_WIDTH = 0.12, 0.06  # standard deviations as fractions of sqrt(area)


def new_sphere(subdivision: int) -> TriangleMesh:
    """Make an icosphere of ``10 * 4**subdivision + 2`` vertices, of which nothing is computed."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivision)
    return TriangleMesh(sphere.vertices, sphere.faces)


def sphere_problem(subdivision: int, parameters: Parameters = PARAMETERS) -> Problem:
    """State the problem on a new icosphere."""
    mesh = new_sphere(subdivision)
    target = _bump(mesh, 1.0, _TARGET_WIDTH) + _bump(mesh, -1.0, _TARGET_WIDTH)
    return Problem(mesh, _bump(mesh, 0.0, _SOURCE_WIDTH), target, parameters)


def _bump(mesh: TriangleMesh, angle: float, width: float) -> FloatArray:
    """Return the Gaussian of the great-circle distance to the point of the equator at an angle in
    radians, (V,).
    """
    cosines = mesh.vertices @ [np.cos(angle), np.sin(angle), 0.0]
    distances = np.arccos(np.clip(cosines, -1.0, 1.0)) / mesh.length_scale
    return np.asarray(np.exp(-0.5 * (distances / width) ** 2))

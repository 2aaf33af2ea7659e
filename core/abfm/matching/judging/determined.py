"""Shares of the fields of a match that its data determine, on each face.

If points are displaced by L along a unit vector e, the advected functions change by about ``L <e,
grad f_t>``. Let S be the mean over the flow's times of ``sum_c w_c grad f_t grad f_t^T``, over the
channels c with weights w, times ``(L / epsilon)^2``. The length L is the typical displacement of
the match. The difference epsilon is the one that the match leaves, or the goal if this is larger.
The share of a velocity v that the functions determine, averaged over adjacent faces, is

    1 - <v, (I + S)^-1 v> / <v, v>

Across contours it is near 1 if a displacement by L changes the functions by more than epsilon.
Along contours of one function, and where functions are flat, it is 0: smoothness alone determines
the motion (the aperture problem). Landmarks determine the motion near their paths. Shares do not
depend on units, on scale or rotation of the surface, or on a common factor of the functions.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from scipy.spatial import cKDTree

from abfm.calculus.operators import averaging, face_areas, gradient
from abfm.calculus.vector_fields import to_frame
from abfm.errors import AbfmError
from abfm.flow import flow_lines
from abfm.matching.problem import Problem
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_TIMES = 16  # times of the flow at which slopes are evaluated


def determined(
    problem: Problem,
    velocity: FloatArray,
    fine_velocity: FloatArray,
    residual: float,
    advect: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return the share of each field of a match that its data determine, (N, F), 0 to 1.

    Parameters
    ----------
    problem : Problem
    velocity, fine_velocity : (N, F, 3) and (N, 4^k F, 3) arrays
        The fields on the mesh, and on the mesh on which they were found.
    residual : float
        Residual of the match; not finite if it is unknown.
    advect : callable
        Returns the functions at times (T,), as an array (T, V) or (T, V, C).
    """
    mesh, functions, tau = problem.mesh.normalized(), problem.functions, problem.parameters.tau
    displacements = np.stack([to_frame(problem.mesh, v) for v in velocity])
    displacements *= tau / problem.mesh.length_scale
    area = float(functions.areas.sum())
    difference = max(residual if np.isfinite(residual) else 1.0, problem.parameters.goal)
    noise = difference * functions.varying_size / np.sqrt(area)
    count, each = len(displacements), -(-_TIMES // len(displacements))
    times = tau * (np.arange(count * each) + 0.5) / (count * each)
    advected = advect(times).reshape(count, each, len(mesh.vertices), -1)
    weights = np.sqrt(functions.weights) / noise
    found = determined_shares(mesh, displacements, advected * weights, problem.mask)
    return np.asarray(1 - (1 - found) * (1 - _near_landmarks(problem, fine_velocity)))


def determined_shares(
    mesh: TriangleMesh,
    displacements: FloatArray,
    functions: FloatArray,
    mask: FloatArray | None = None,
) -> FloatArray:
    """Return the shares of displacements that functions determine, (N, F).

    Parameters
    ----------
    mesh : TriangleMesh
    displacements : (N, F, 2) array
        Displacement of the complete flow by each of its fields, in the face frames.
    functions : (N, T, V, C) array
        Channels at T times of each field, relative to the smallest difference that counts.
    mask : (V,) array, optional
        Weights of the vertices.
    """
    squares = (displacements**2).sum(axis=2)
    moved = squares @ face_areas(mesh)
    length2 = float((squares**2 @ face_areas(mesh)).sum() / moved.sum()) if moved.any() else 0.0
    derive, faces = gradient(mesh), len(mesh.faces)
    counted = np.ones(faces) if mask is None else mask[mesh.faces].mean(axis=1)
    found = np.empty(squares.shape)
    for row, (displacement, of_field) in enumerate(zip(displacements, functions, strict=True)):
        tensors = np.zeros((faces, 2, 2))
        for function in of_field.transpose(0, 2, 1).reshape(-1, len(mesh.vertices)):
            slope = (derive @ np.ascontiguousarray(function)).reshape(-1, 2)
            tensors += slope[:, :, None] * slope[:, None, :]
        tensors *= (length2 / len(of_field) * counted)[:, None, None]
        free = np.linalg.inv(np.eye(2) + tensors)
        still = ~displacement.any(axis=1)
        of_motion = np.einsum("fx,fxy,fy->f", displacement, free, displacement)
        mean = np.trace(free, axis1=1, axis2=2) / 2
        share = np.where(still, mean, of_motion / np.where(still, 1.0, squares[row]))
        at_vertices = averaging(mesh) @ np.clip(1 - share, 0.0, 1.0)
        found[row] = at_vertices[mesh.faces].mean(axis=1)
    return found


def _near_landmarks(problem: Problem, fine_velocity: FloatArray) -> FloatArray:
    """Return how near to paths of landmarks the faces are, (F,), from 0 to 1 on a path.

    The value decreases over the length sqrt(alpha), over which the norm smooths fields.
    """
    mesh, landmarks = problem.mesh, problem.landmarks
    if landmarks is None:
        return np.zeros(len(mesh.faces))
    starts, tau = landmarks.points(mesh), problem.parameters.tau
    places = [starts.positions, landmarks.targets(mesh).positions]
    with suppress(AbfmError):  # flow lines that cross too many faces
        lines = flow_lines(mesh, fine_velocity, starts, tau, tau)
        places += [line.positions for line in lines]
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    distances, _ = cKDTree(np.concatenate(places)).query(middles)
    length2 = max(problem.parameters.alpha, 1e-12) * mesh.length_scale**2
    return np.asarray(np.exp(-(distances**2) / (2 * length2)))

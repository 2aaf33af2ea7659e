"""Functional maps by descriptors, in least squares.

Descriptors are functions with the same meaning on both surfaces:

- wave kernel signatures,
- delta functions at landmarks, in bands of eigenvalues,
- given functions.

References
----------
Ovsjanikov, Ben-Chen, Solomon, Butscher, Guibas: Functional Maps, ACM TOG 31(4), 2012.
Aubry, Schlickewei, Cremers: The Wave Kernel Signature, ICCV Workshops 2011.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.functions.local_shape import Curvature
from abfm.functions.spectral import WaveKernelSignature
from abfm.maps.functional_maps import spectral_coefficients
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_ENERGIES = 20  # evenly spaced logarithms of eigenvalues, with one descriptor each
_CURVATURE_MAX = 30.0  # a larger mean curvature, in 1 / sqrt(area), is a crease or noise
_COMMUTATOR_WEIGHT = 0.1  # weight of commuting with the Laplacian, relative to all descriptors


class Hints(NamedTuple):
    """Data that a map should preserve: landmarks and functions, expressed by eigenfunctions."""

    places: FloatArray  # (L, 3), landmarks on A, in sqrt(area)
    at_landmarks: tuple[FloatArray, FloatArray]  # (L, K), values of eigenfunctions
    weights: FloatArray  # (L,), weights of the landmarks, with mean 1
    functions: tuple[FloatArray, FloatArray]  # (K, C), coefficients with norm 1, on A and on B


def map_of_descriptors(a: TriangleMesh, b: TriangleMesh, hints: Hints, k: int) -> FloatArray:
    """Return the functional map (k, k) that transfers descriptors from A to B.

    It nearly commutes with the Laplacian. Each row solves a separate least-squares problem
    [OBC*12, 5.2].
    """
    values = [unit_eigenbasis(mesh, k)[0] for mesh in (a, b)]
    kinds = [
        [_signatures(mesh, k) for mesh in (a, b)],
        [_bands(each, rows[:, :k]) for each, rows in zip(values, hints.at_landmarks, strict=True)],
        [coefficients[:k] for coefficients in hints.functions],
    ]
    of_a, of_b = (np.hstack([kind[side] for kind in kinds]) for side in (0, 1))
    landmark_weights = np.repeat(hints.weights, _ENERGIES)
    weights = np.concatenate([np.ones(_ENERGIES), landmark_weights, np.ones(kinds[2][0].shape[1])])
    # descriptors are scaled to equal norms, so that only landmarks have different weights
    size = np.sqrt((np.linalg.norm(of_a, axis=0) ** 2 + np.linalg.norm(of_b, axis=0) ** 2) / 2)
    used = size > 0
    scale = np.sqrt(weights[used]) / size[used]
    of_a, of_b = of_a[:, used] * scale, of_b[:, used] * scale
    gaps = (values[0] - values[1][:, None]) ** 2 / values[0].max() ** 2
    weight = _COMMUTATOR_WEIGHT * weights[used].sum()
    gram = of_a @ of_a.T
    # the first row and column map constants to constants
    rows = [
        np.linalg.solve(gram + weight * np.diag(gaps[i] + 1e-9), of_a @ of_b[i]) for i in range(k)
    ]
    C = np.array(rows)
    C[0], C[:, 0] = 0, 0
    C[0, 0] = 1
    return C


def curvature_coefficients(mesh: TriangleMesh, k: int) -> FloatArray:
    """Return the coefficients (k,) of the mean curvature in the first k eigenfunctions.

    The surface is scaled to unit area, and the curvature is clipped at creases. It is 0 if every
    vertex is on the boundary.
    """
    if mesh.is_boundary_vertex.all():
        return np.zeros(k)
    curvature = Curvature(kind="mean").evaluate(mesh.normalized())
    return spectral_coefficients(mesh, np.clip(curvature, -_CURVATURE_MAX, _CURVATURE_MAX), k)


def _signatures(mesh: TriangleMesh, k: int) -> FloatArray:
    """Return coefficients (k, E) of wave kernel signatures at E energies, minus their means."""
    pairs = min(128, len(mesh.vertices))
    energies = _energies(unit_eigenbasis(mesh, pairs)[0])
    found = [
        WaveKernelSignature(energy=float(e), eigenpairs=pairs).evaluate(mesh) for e in energies
    ]
    coefficients = spectral_coefficients(mesh, np.stack(found, axis=1), k)
    coefficients[0] = 0
    return coefficients


def _bands(values: FloatArray, rows: FloatArray) -> FloatArray:
    """Return coefficients (k, L E) of delta functions at L points, in each of E frequency bands.

    ``values`` (k,) are the eigenvalues, and ``rows`` (L, k) the eigenfunctions at the points.
    """
    energies = _energies(values)
    width = 1.5 * (energies[1] - energies[0])
    logarithms = np.log(np.maximum(values, values[1] / 4))
    bands = np.exp(-0.5 * ((energies - logarithms[:, None]) / width) ** 2)
    return np.asarray((rows.T[:, :, None] * bands[:, None]).reshape(len(values), -1))


def _energies(values: FloatArray) -> FloatArray:
    return np.linspace(np.log(values[1]), np.log(values[-1]), _ENERGIES)


def dissimilarity(one: FloatArray, other: FloatArray, areas: FloatArray) -> FloatArray:
    """Return 1 - r, (C,), for the area-weighted correlations r of two sets of functions (V, C).

    The sum of ``areas`` (V,) must be 1. The correlation of a constant is 0.
    """
    one, other = one - areas @ one, other - areas @ other
    sizes = (areas @ one**2) * (areas @ other**2)
    products = areas @ (one * other)
    return 1 - np.divide(products, np.sqrt(sizes), out=np.zeros_like(products), where=sizes > 0)

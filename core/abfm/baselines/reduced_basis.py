"""Continuous matching in a reduced spectral basis: few smooth fields, dense exponentials.

The method follows Corman, Ovsjanikov, Chambolle: Continuous Matching via Vector Field Flow, SGP
2015. A field is a combination of gradients and rotated gradients of the first eigenfunctions. The
derivative along a field is a small dense matrix in the eigenbasis. An initial functional map is
composed with the flow of the field to approximate a target functional map.

The derivative of the exponential is exact, as a block of a larger exponential. It is computed for
all fields at once by the adjoint of the exponential, while the paper computes it for one field at a
time. Harmonic fields, which exist on surfaces with handles, are not included.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm, expm_frechet
from scipy.optimize import fmin_l_bfgs_b
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigsh

from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import (
    averaging,
    field_mass,
    gradient,
    hodge_gradients,
    rotation,
    vertex_areas,
)
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import real_numbers
from abfm.parameters import Parameters
from abfm.types import FloatArray

_MEMORY = 30  # pairs stored by L-BFGS
_ITERATIONS_MAX = 150  # L-BFGS iterations


@dataclass(frozen=True, eq=False)
class ReducedMatch:
    """The result of a match in a reduced basis."""

    velocity: FloatArray  # (F, 3), field in the input's units
    functional_map: FloatArray  # (k, m), map in the reduced basis
    start_mismatch: float  # ``||C - C_target|| / ||C_target||`` of the initial map, Frobenius norm
    mismatch: float  # the same ratio for the map after the match


class ReducedEnergy:
    """The energy of a field in a reduced basis, and its gradient.

    The basis has the first eigenfields of the Hodge Laplacian: ``fields`` gradients, and as many
    rotated gradients. A field has coefficients a in this basis. ``Lambda`` has the eigenvalues.
    ``D(a)`` is the derivative along the field as a matrix (k, k) in the first k eigenfunctions. The
    energy is ``1/2 <a, (id + alpha Lambda) a> + ||exp(-tau D(a)) C_start - C_target||^2 / (2
    sigma^2)``.

    ``start`` (the initial map) and ``target`` are functional maps (k, m) to ``mesh``.
    ``parameters`` has alpha, tau and sigma. Raises an AbfmError if the maps or the number of fields
    are invalid.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        start: ArrayLike,
        target: ArrayLike,
        parameters: Parameters,
        fields: int = 50,
    ) -> None:
        self.start, self.target = (
            real_numbers(C, "a functional map", ParameterError) for C in (start, target)
        )
        if self.start.ndim != 2 or self.start.shape != self.target.shape or 0 in self.start.shape:
            raise ParameterError(
                f"functional maps have shapes {self.start.shape} and {self.target.shape}; "
                "expected two matrices of equal shape"
            )
        if not (np.isfinite(self.start).all() and np.isfinite(self.target).all()):
            raise ParameterError(
                "a functional map has values that are not finite; expected finite values"
            )
        if not fields >= 1:
            raise ParameterError(f"fields is {fields}; expected a positive integer")
        self.mesh, self.length_scale = mesh.normalized(), mesh.length_scale
        self.tau, self.sigma = parameters.tau, parameters.last_sigma
        eigenvalues, self.basis = hodge_basis(self.mesh, fields)
        self.weights = 1 + parameters.alpha * eigenvalues
        self.operators = _operators(self.mesh, self.basis, len(self.start))

    def exponent(self, a: FloatArray) -> FloatArray:
        """Return the exponent ``-tau D(a)`` (k, k) of the flow of a field with coefficients a."""
        return -self.tau * np.tensordot(a, self.operators, 1)

    def __call__(self, a: FloatArray) -> tuple[float, FloatArray]:
        """Return the energy and its gradient (M,) for the coefficients ``a`` (M,) of a field.

        If the energy overflows, return infinity and a zero gradient.
        """
        exponent = self.exponent(a)
        with np.errstate(all="ignore"):
            difference = expm(exponent) @ self.start - self.target
            energy = 0.5 * float(self.weights @ a**2 + (difference**2).sum() / self.sigma**2)
        if not np.isfinite(energy):
            return np.inf, np.zeros_like(a)
        direction = difference @ self.start.T / self.sigma**2
        slope = np.asarray(expm_frechet(exponent.T, direction, compute_expm=False), np.float64)
        gradient = self.weights * a - self.tau * np.tensordot(self.operators, slope, 2)
        return energy, np.asarray(gradient)


def reduced_match(energy: ReducedEnergy) -> ReducedMatch:
    """Minimise the energy by L-BFGS, from the zero field; return the field and the improved map."""
    first = np.zeros(len(energy.weights))
    best = fmin_l_bfgs_b(energy, first, m=_MEMORY, maxiter=_ITERATIONS_MAX)[0]
    final, size = expm(energy.exponent(best)) @ energy.start, np.linalg.norm(energy.target)
    field = to_ambient(energy.mesh, (energy.basis @ best).reshape(-1, 2))
    return ReducedMatch(
        velocity=field * energy.length_scale,
        functional_map=final,
        start_mismatch=float(np.linalg.norm(energy.start - energy.target) / size),
        mismatch=float(np.linalg.norm(final - energy.target) / size),
    )


def hodge_basis(mesh: TriangleMesh, count: int) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (2 count,) and eigenfields (2F, 2 count) of the Hodge Laplacian.

    The eigenfields are columns of coefficients in the local frames of the faces, with norm 1. The
    first ``count`` are gradients of the first eigenfunctions except the constant one; the others
    are rotated gradients. If there is a boundary, the rotated gradients are those of functions that
    vanish there, so no field has a flux through it.
    """
    values, functions = (part[..., 1:] for part in eigenbasis(mesh, count + 1))
    gradients = gradient(mesh) @ functions / np.sqrt(values)
    if mesh.is_closed:
        return np.tile(values, 2), np.concatenate([gradients, rotation(mesh) @ gradients], axis=1)
    rotated_gradient = hodge_gradients(mesh)[1]
    inner = rotated_gradient.shape[1]
    if not count < inner:
        raise ParameterError(
            f"fields is {count}; expected at most {inner - 1} on a mesh with {inner} vertices off "
            "the boundary"
        )
    root_mass = np.sqrt(vertex_areas(mesh)[~mesh.is_boundary_vertex])
    scale = diags_array(1 / root_mass)
    operator = csr_array(scale @ rotated_gradient.T @ field_mass(mesh) @ rotated_gradient @ scale)
    inverse = LinearOperator((inner, inner), matvec=factor(operator), dtype=np.float64)
    start = np.sin(np.arange(1.0, inner + 1))
    inner_values, vectors = eigsh(operator, k=count, sigma=0, OPinv=inverse, v0=start, rng=0)
    rotated = rotated_gradient @ (vectors / root_mass[:, None]) / np.sqrt(inner_values)
    return np.concatenate([values, inner_values]), np.concatenate([gradients, rotated], axis=1)


def _operators(mesh: TriangleMesh, basis: FloatArray, k: int) -> FloatArray:
    """Return the derivatives along the M fields of ``basis`` as matrices, shape (M, k, k).

    The matrix of a field v is ``Phi^+ D_v Phi``, where ``Phi`` has the first k eigenfunctions.
    """
    functions = eigenbasis(mesh, k)[1]
    slopes = (gradient(mesh) @ functions).reshape(-1, 2, k)
    tests = averaging(mesh).T @ (vertex_areas(mesh)[:, None] * functions)
    fields = basis.T.reshape(basis.shape[1], -1, 2)
    return np.stack([tests.T @ np.einsum("fx,fxk->fk", field, slopes) for field in fields])

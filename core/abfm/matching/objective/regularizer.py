"""The norm ``||v||_alpha`` of fields (section 3) and its exact inverse.

``R = G_F D_alpha = M + M (alpha_1 A G_1^-1 A^T + alpha B G_0^-1 B^T) M``, where ``M = G_F`` is the
mass matrix of fields. ``A`` are gradients of edge functions, and ``B`` are rotated gradients of
vertex functions; ``G_1`` and ``G_0`` are the masses of these functions. In the paper, divergence
and curl have the same weight, ``alpha_1 = alpha``. Here the weight of the divergence may be larger.

Because ``A^T M B = 0``, the Woodbury identity splits into two scalar problems,
``R^-1 = M^-1 - alpha_1 A (G_1 + alpha_1 A^T M A)^-1 A^T - alpha B (G_0 + alpha B^T M B)^-1 B^T``.

The norm of second order, ``(id + alpha Delta_H)^2``, is ``R M^-1 R``, with the inverse
``R^-1 M R^-1``. Fields with a finite norm of second order are continuous. In two dimensions, this
is not true for the norm of first order, which the paper uses.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy import sparse

from abfm.calculus.operators import Matrix, mollified_shapes, stiffness
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import Solve, factor
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray

# Gradients (F, 3, 2) of the hat functions of corners, edges opposite the corners (F, 3), and
# vertices (F, 3). Edge functions have -2 times the gradient of the opposite corner. Gradients of
# vertex functions are rotated by a right angle, so that both kinds are orthogonal.
Slopes = tuple[FloatArray, IndexArray, IndexArray]

# least ratio of mass to stiffness of an edge or a vertex that keeps the matrix definite
_MASS_SHARE_MIN = 1e-13


class Regularizer:
    """The norm ``R = G_F D_alpha^order`` on frame coefficients (F, 2) of a field, and its inverse.

    The argument ``divergence`` is the weight of the divergence relative to the curl. The norm of
    the paper has ``order`` 1 and ``divergence`` 1.
    """

    def __init__(
        self, mesh: TriangleMesh, alpha: float, order: int = 1, divergence: float = 1.0
    ) -> None:
        self.alpha, self.order, self.divergence = alpha, order, divergence
        # no reference to the mesh, whose cache has this object: a cycle would keep both alive
        shapes = mollified_shapes(mesh)
        self._areas, self._gradients = shapes.areas, shapes.gradients
        self._edges, self._vertices = mesh.face_edges, mesh.faces
        self._slopes = self._gradients, self._edges, self._vertices
        self._inner = ~mesh.is_boundary_vertex
        # weights of divergence and curl; edge functions have twice the gradients of hat functions
        self._alphas = 4 * divergence * alpha, alpha
        of_edges, of_vertices = self._alphas
        masses = self._definite(shapes.vertex_areas, self._vertices, of_vertices)
        edge_masses = self._definite(shapes.edge_areas, self._edges, of_edges)
        self._masses = edge_masses, np.where(self._inner, masses, np.inf)
        self._factors: list[Solve] = []  # factors shared by norms of all orders

    def _definite(self, masses: FloatArray, owners: IntArray, alpha: float) -> FloatArray:
        """Return masses large enough for a matrix of mass plus stiffness to be positive definite.

        Smaller masses are raised to the size of rounding errors of the stiffness.
        """
        of_corners = np.einsum("fck,fck->fc", self._gradients, self._gradients)
        weights = alpha * self._areas[:, None] * of_corners
        diagonal = np.bincount(owners.ravel(), weights.ravel(), minlength=len(masses))
        return np.asarray(np.maximum(masses, _MASS_SHARE_MIN * diagonal))

    @property
    def mass(self) -> FloatArray:
        return np.repeat(self._areas, 2)

    @property
    def _solvers(self) -> list[Solve]:
        if not self._factors:
            found, owners = [], (self._edges, self._vertices)
            for of, masses, alpha in zip(owners, self._masses, self._alphas, strict=True):
                form = stiffness(self._gradients, alpha * self._areas, of, len(masses))
                inner = np.isfinite(masses)
                if not inner.all():
                    form = form[inner][:, inner]
                found.append(factor(Matrix(form + sparse.diags_array(masses[inner]))))
            self._factors[:] = found  # set both at once, as other threads may use them
        return self._factors

    def of_order(self, order: int) -> Regularizer:
        """Return the norm of another order, which shares the factorisations."""
        other = copy(self)
        other.order = order
        return other

    def apply(self, v: FloatArray) -> FloatArray:
        momentum = self._apply_once(v)
        for _ in range(self.order - 1):
            momentum = self._apply_once(momentum / self._areas[:, None])
        return momentum

    def inverse(self, momentum: FloatArray) -> FloatArray:
        """Return ``R^-1 m`` for a momentum m (F, 2), by two scalar solves for each order.

        The first call factorises both matrices.
        """
        v = self._invert_once(momentum)
        for _ in range(self.order - 1):
            v = self._invert_once(self._areas[:, None] * v)
        return v

    def _apply_once(self, v: FloatArray) -> FloatArray:
        momentum = self._areas[:, None] * v
        if self.alpha > 0:
            (of_edges, of_vertices), (edge_masses, masses) = self._products(momentum), self._masses
            on_edges = self.divergence * (of_edges / edge_masses)
            on_vertices = of_vertices / masses
            factors = self.alpha * self._areas
            add_gradients(self._slopes, on_edges, on_vertices, factors, momentum)
        return momentum

    def _invert_once(self, momentum: FloatArray) -> FloatArray:
        v: FloatArray = momentum / self._areas[:, None]
        if self.alpha > 0:
            on_edges, on_vertices = self._products(momentum)
            solve_edges, solve_vertices = self._solvers
            potential = np.zeros_like(on_vertices)
            potential[self._inner] = solve_vertices(on_vertices[self._inner])
            factors = np.full_like(self._areas, -self.alpha)
            on_edges = self.divergence * solve_edges(on_edges)
            add_gradients(self._slopes, on_edges, potential, factors, v)
        return v

    def _products(self, momentum: FloatArray) -> tuple[FloatArray, FloatArray]:
        of_edges, of_vertices = (np.zeros(len(masses)) for masses in self._masses)
        add_products(self._slopes, momentum, of_edges, of_vertices)
        return of_edges, of_vertices


def regularizer(
    mesh: TriangleMesh, alpha: float, order: int = 1, divergence: float = 1.0
) -> Regularizer:
    """Return the norm of the fields on a mesh; each mesh caches its latest norm."""
    latest: Regularizer | None = mesh.cache.get("regularizer")
    if latest is None or (latest.alpha, latest.divergence) != (alpha, divergence):
        latest = mesh.cache["regularizer"] = Regularizer(mesh, alpha, order, divergence)
    return latest if latest.order == order else latest.of_order(order)


@kernel
def add_products(
    slopes: Slopes, v: FloatArray, of_edges: FloatArray, of_vertices: FloatArray
) -> None:
    """Add products of a field (F, 2) and gradients of edge and vertex functions to two arrays.

    The arrays are ``of_edges`` and ``of_vertices``, with a value for each function.
    """
    gradients, edges, vertices = slopes
    for f in range(edges.shape[0]):
        for c in range(3):
            x, y = gradients[f, c, 0], gradients[f, c, 1]
            of_edges[edges[f, c]] -= 2.0 * (x * v[f, 0] + y * v[f, 1])
            of_vertices[vertices[f, c]] += x * v[f, 1] - y * v[f, 0]


@kernel
def add_gradients(
    slopes: Slopes,
    on_edges: FloatArray,
    on_vertices: FloatArray,
    factors: FloatArray,
    out: FloatArray,
) -> None:
    """Add gradients of edge and vertex functions, times factors (F,), to a field ``out`` (F, 2)."""
    gradients, edges, vertices = slopes
    for f in range(edges.shape[0]):
        first, second = 0.0, 0.0
        for c in range(3):
            x, y = gradients[f, c, 0], gradients[f, c, 1]
            edge, vertex = -2.0 * on_edges[edges[f, c]], on_vertices[vertices[f, c]]
            first += edge * x - vertex * y
            second += edge * y + vertex * x
        out[f, 0] += factors[f] * first
        out[f, 1] += factors[f] * second

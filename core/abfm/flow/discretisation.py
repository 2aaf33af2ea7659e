"""How flows are computed on a mesh."""

from __future__ import annotations

import numpy as np

from abfm.flow.advection import Advection, FieldFlow, LinearizedFlow
from abfm.flow.derivative_pattern import DerivativePattern, clustered_pattern, derivative_pattern
from abfm.flow.exponential import TOLERANCE, ExponentialFlow, Workspace
from abfm.mesh import TriangleMesh
from abfm.parameters import Method
from abfm.types import FloatArray


class Discretisation:
    """The functions that are advected on a mesh, the steps by which they are, and the memory for
    it.

    Parameters
    ----------
    mesh : TriangleMesh
    method : "nonlinear" or "linearised"
        ``exp(-t D_v)`` (Eq. 4) of each field, or its first two terms ``id - t D_v`` (Eq. 5).
    pattern : DerivativePattern, optional
        Of ``D_v``; by default that of functions with a value on each vertex.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        method: Method = "nonlinear",
        pattern: DerivativePattern | None = None,
    ) -> None:
        self.mesh, self.method = mesh, method
        self.pattern = derivative_pattern(mesh) if pattern is None else pattern
        self.workspace = Workspace(self.pattern.size)

    @property
    def size(self) -> int:
        """Values of a function that is advected: vertices, or clusters of them."""
        return self.pattern.size

    def clustered(self) -> Discretisation:
        """Return the same for functions with one value on each of `abfm.flow.clusters`."""
        return Discretisation(self.mesh, self.method, clustered_pattern(self.mesh))

    def flow(self, fields: FloatArray, tau: float, tolerance: float = TOLERANCE) -> Advection:
        """Return the flow of N fields (N, F, 2) in a row, each for ``tau / N``.

        The fields are frame coefficients, in the mesh's units; ``tolerance`` is where series are
        truncated. Terms that earlier flows keep in the workspace are forgotten.
        """
        self.workspace.release()
        parts = [self._part(v, tolerance) for v in np.ascontiguousarray(fields)]
        return Advection(parts, tau / len(fields))

    def _part(self, v: FloatArray, tolerance: float) -> FieldFlow:
        if self.method == "linearised":
            return LinearizedFlow(self.pattern, v)
        return ExponentialFlow(self.pattern, v, self.workspace, tolerance)

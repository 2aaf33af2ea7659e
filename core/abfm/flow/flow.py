"""The flow of given fields: functions carried along it, and where its points come from."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.vector_fields import to_frame
from abfm.errors import AdvectionError, ParameterError, brief
from abfm.flow.advection import Advection
from abfm.flow.exponential import Workspace
from abfm.flow.flow_lines import fields_in_a_row
from abfm.maps.surface_points import SurfacePoints, project_onto_surface
from abfm.mesh import TriangleMesh, per_mesh
from abfm.parameters import CHOICES, Method
from abfm.real_numbers import is_finite_number, real_numbers
from abfm.types import FloatArray


class Flow:
    """The flow of one tangent field, or of N fields in a row, each for ``tau / N``; beyond tau the last one goes on.

    A negative time undoes the flow. Exponentials are undone exactly; linearised steps by the same steps with the sign
    changed, in reverse order, which is not an exact inverse.

    Parameters
    ----------
    mesh : TriangleMesh
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time, such as ``match.velocity``; a normal part is
        dropped. The attribute is (N, F, 3).
    method : "nonlinear" or "linearised"
        ``exp(-t D_v)`` (Eq. 4), or its first two terms ``id - t D_v`` (Eq. 5), one step for each field: for smaller
        steps repeat the fields.

    Raises
    ------
    ParameterError
        If the fields have another shape or values that are not finite, tau is not a positive number, or there is no
        such method.
    """

    def __init__(self, mesh: TriangleMesh, velocity: ArrayLike, tau: float = 1.0, method: Method = "nonlinear") -> None:
        if not (is_finite_number(tau) and tau > 0):
            raise ParameterError(f"tau is {brief(tau)}; expected a positive time")
        if not isinstance(method, str) or method not in CHOICES["method"]:
            expected = " or ".join(map(repr, CHOICES["method"]))
            raise ParameterError(f"method is {brief(method)}; expected {expected}")
        self.mesh, self.tau, self.method = mesh, float(tau), method
        self.velocity = fields_in_a_row(mesh, velocity)

    def __getstate__(self) -> dict[str, Any]:
        """What a copy, or the flow in another process, has: it computes what it needs itself."""
        return {name: value for name, value in self.__dict__.items() if name != "_advection"}

    def push(self, h: ArrayLike, t: ArrayLike) -> FloatArray:
        """Any function (V,) or (V, C) carried to time ``t``, in the same shape; to several times (T,) as by `span`.

        Raises
        ------
        ParameterError
            If a time is not a finite number.
        FunctionError
            If ``h`` does not fit the mesh.
        AdvectionError
            If the flow overflows or is too long.
        """
        times = real_numbers(t, "t", ParameterError)
        return self.span(h, times) if times.ndim else self.span(h, times[None])[0]

    def advect(self, f: ArrayLike, t: ArrayLike | None = None) -> FloatArray:
        """As `push`, to the end time where none is given."""
        return self.push(f, self.tau if t is None else t)

    def span(self, h: ArrayLike, times: ArrayLike) -> FloatArray:
        """A function (V,) or (V, C) at many times (T,), (T, ...): in one pass, much faster than one by one.

        Raises what `push` does.
        """
        moments = real_numbers(times, "t", ParameterError)
        if moments.ndim != 1 or not np.isfinite(moments).all():
            raise ParameterError(f"t is {brief(times)}; expected a finite time or a list of them")
        rows = channels(self.mesh, h, "h")
        workspace = _workspace(self.mesh)
        with workspace.lock:
            carried = np.stack([self._advection.at(row, moments) for row in rows], axis=-1)
        if not np.isfinite(carried).all():
            raise AdvectionError("the function overflows on its way: the discrete flow is unstable over this time")
        return carried.reshape(len(moments), len(self.mesh.vertices), *np.shape(h)[1:])

    def point_map(self, t: float | None = None) -> SurfacePoints:
        """Where each vertex's value came from at time ``t`` (tau by default), as points on the surface.

        The flow carries the coordinate functions; the closest point of the surface to what arrives is the answer. A
        negative time gives the inverse map: where each vertex goes.
        """
        return project_onto_surface(self.mesh, self.advect(self.mesh.vertices, t))

    @cached_property
    def _advection(self) -> Advection:
        """Time does not depend on the units: those of the mesh will do."""
        fields = to_frame(self.mesh, self.velocity)
        return Advection(self.mesh, fields, self.tau, self.method == "linearised", _workspace(self.mesh))


@per_mesh
def _workspace(mesh: TriangleMesh) -> Workspace:
    """Memory of all flows on a mesh."""
    return Workspace(len(mesh.vertices))

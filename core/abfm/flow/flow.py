"""The flow of given fields: functions carried along it, and the maps that it makes."""

from collections.abc import Iterator
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.calculus.vector_fields import check_field, to_frame
from abfm.errors import AdvectionError, ParameterError, brief
from abfm.flow.advection import Advection, Discretisation
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.flow.flow_lines import checked_fields
from abfm.maps.distortion import Distortion, SurfaceMap
from abfm.maps.functional_maps import spectral_coefficients
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import FlowMapQuality, RoundTrip, round_trip
from abfm.mesh import MeshLike, TriangleMesh, as_mesh, per_mesh
from abfm.mesh.subdivision import interpolated, mean_of_children, refined
from abfm.numerics.real_numbers import is_finite_number, real_numbers
from abfm.parameters import CHOICES, Method
from abfm.types import FloatArray


def flow_maps(lines: ContinuousFlow, times: FloatArray, inverse: bool) -> Iterator[PointMap]:
    """Map vertices to where their values came from at each of the times (T,), or, ``inverse``, to
    where they go; at negative times the other way round.

    Points continue from the time before, if that is less and they move ahead, or back along a
    single field.
    """
    mesh, points = lines.mesh, None
    from_time, went_ahead = 0.0, False
    for time in times.tolist():
        ahead, until = inverse != (time < 0), abs(time)
        goes_on = went_ahead is ahead and from_time <= until
        if not goes_on or not (ahead or len(lines.fields) == 1):
            points, from_time = None, 0.0
        begin, end = (from_time, until) if ahead else (until, from_time)
        points = lines.between(points, begin, end)
        from_time, went_ahead = until, ahead
        yield PointMap.of_points(mesh, points, map_of_points(lines, time, inverse))


def map_of_points(lines: ContinuousFlow, time: float, inverse: bool) -> SurfaceMap:
    """Return what takes points where `flow_maps` takes vertices."""
    ahead = inverse != (time < 0)
    return partial(lines.destinations if ahead else lines.origins, t=abs(time))


class Flow:
    """The flow of one tangent field, or of N fields in a row, each for ``tau / N``.

    A function is carried by ``f_t = exp(-t D_v) f`` (Eq. 4), which solves
    ``df/dt + <v, grad f> = 0``: its values move with the field. Of several fields the last one goes
    on beyond ``tau``. A negative time undoes the flow: exponentials exactly, linearised steps by
    the same steps with the sign changed, in reverse order, which is not an exact inverse.

    >>> import abfm, numpy as np
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("eight.off"))
    >>> f = abfm.function(mesh, "gaussian:vertex=12,width=0.2")
    >>> rotation = np.cross([0, 0, 1], mesh.vertices[mesh.faces].mean(axis=1))
    >>> flow = abfm.Flow(mesh, rotation, tau=0.5)
    >>> flow.push(f, [0, 0.25, 0.5]).shape == (3, len(f))
    True
    >>> bool(np.allclose(flow.push(flow.push(f), -0.5), f, atol=1e-6))
    True

    Parameters
    ----------
    mesh : TriangleMesh
    velocity : (F, 3) or (N, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time, such as ``match.velocity``; a
        normal part is dropped. Also (4^k F, 3) or (N, 4^k F, 3), such as ``match.fine_velocity``,
        on the mesh subdivided k times: functions are interpolated there, carried there, and told at
        the mesh's own vertices. The attributes are ``velocity`` (N, F, 3), then a mean over
        children, ``fine_velocity`` as given, ``fine_mesh``, and k, ``refined``.
    method : "nonlinear" or "linearised"
        ``exp(-t D_v)`` (Eq. 4), or its first two terms ``id - t D_v`` (Eq. 5), one step for each
        field: for smaller steps repeat the fields.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        velocity: ArrayLike,
        tau: float = 1.0,
        method: Method = "nonlinear",
    ) -> None:
        if not (is_finite_number(tau) and tau > 0):
            raise ParameterError(f"tau is {brief(tau)}; expected a positive time")
        if not isinstance(method, str) or method not in CHOICES["method"]:
            expected = " or ".join(map(repr, CHOICES["method"]))
            raise ParameterError(f"method is {brief(method)}; expected {expected}")
        self.mesh, self.tau, self.method = mesh, float(tau), method
        self.fine_velocity, self.refined = checked_fields(mesh, velocity)

    @property
    def fine_mesh(self) -> TriangleMesh:
        """The mesh of the fields."""
        return refined(self.mesh, self.refined)

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields on the mesh itself, (N, F, 3)."""
        return mean_of_children(self.fine_velocity, len(self.mesh.faces))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of copies, and of the flow in another process, what these compute again."""
        left_out = ("_advection", "_lines")
        return {name: value for name, value in self.__dict__.items() if name not in left_out}

    def push(self, h: ArrayLike, t: ArrayLike | None = None) -> FloatArray:
        """Carry any function (V,) or (V, C) to time ``t`` (tau by default), in the same shape, or
        to several times (T,), (T, ...), in one pass, which is much faster than one by one.

        Raises
        ------
        AdvectionError
            If the flow overflows or is too long.
        """
        times = real_numbers(self.tau if t is None else t, "t", ParameterError)
        moments = np.atleast_1d(times)
        if moments.ndim != 1 or not np.isfinite(moments).all():
            raise ParameterError(f"t is {brief(t)}; expected a finite time or a list of them")
        values = interpolated(self.mesh, channels(self.mesh, h, "h").T, self.refined)
        rows = np.ascontiguousarray(values.T)
        with _discretisation(self.fine_mesh, self.method).workspace.lock:
            carried = np.stack([self._advection.at(row, moments) for row in rows], axis=-1)
        if not np.isfinite(carried).all():
            raise AdvectionError(
                "the function overflows on its way: the discrete flow is unstable over this time"
            )
        carried = carried[:, : len(self.mesh.vertices)]
        return carried.reshape(*times.shape, len(self.mesh.vertices), *np.shape(h)[1:])

    def point_map(self, t: float | None = None, inverse: bool = False) -> PointMap:
        """Return where each vertex's value came from at time ``t`` (tau by default), by the flow
        lines of the continuous field (`ContinuousFlow`), or, ``inverse``, where it goes.

        Beyond tau the last field goes on. A negative time asks for the inverse of the other one.
        """
        [found] = self.point_maps([self.tau if t is None else t], inverse)
        return found

    def point_maps(self, times: ArrayLike, inverse: bool = False) -> Iterator[PointMap]:
        """Return the maps of several times (T,), one after the other; in ascending order they are
        walked once, each from the one before, and not from zero, where that is possible.
        """
        moments = np.atleast_1d(real_numbers(times, "t", ParameterError))
        if moments.ndim != 1 or not np.isfinite(moments).all():
            raise ParameterError(f"t is {brief(times)}; expected a finite time or a list of them")
        return flow_maps(self._lines, moments, inverse)

    def coordinate_map(self, t: float | None = None) -> PointMap:
        """Return the map as the paper reads it: for each vertex the point of the surface closest
        to the coordinates that `push` carries there. Discrete flows may fold it.
        """
        return PointMap.project(self.mesh, self.mesh, self.push(self.mesh.vertices, t))

    def distortion(self, t: float | None = None) -> Distortion:
        """Measure the map of each vertex to where it is at time ``t`` (tau by default), see
        `PointMap.distortion`.
        """
        return self.point_map(t, inverse=True).distortion()

    def round_trip(self, t: float | None = None) -> RoundTrip:
        """Measure how far from itself a vertex comes back, in edges: `abfm.maps.round_trip`."""
        return self._round_trip(self.point_map(t, inverse=True), t)

    def map_quality(self, t: float | None = None) -> FlowMapQuality:
        """Tell what the map of time ``t`` does to faces, and whether points come back."""
        there = self.point_map(t, inverse=True)
        return FlowMapQuality(there.distortion(), self._round_trip(there, t))

    def _round_trip(self, there: PointMap, t: float | None) -> RoundTrip:
        back = map_of_points(self._lines, self.tau if t is None else t, inverse=False)
        return round_trip(there, back)

    def functional_map(self, k: int, t: float | None = None) -> FloatArray:
        """Return the flow to time ``t`` (tau by default) on coefficients in the first k
        eigenfunctions (section 4): ``Phi^+ exp(-t D_v) Phi``, (k, k).
        """
        basis = unit_eigenbasis(self.mesh, k)[1]
        return spectral_coefficients(self.mesh, self.push(basis, t), k)

    @cached_property
    def _lines(self) -> ContinuousFlow:
        return ContinuousFlow(self.mesh, self.fine_velocity, self.tau)

    @cached_property
    def _advection(self) -> Advection:
        """The discrete flow, in the mesh's units: times do not depend on them."""
        fields = to_frame(self.fine_mesh, self.fine_velocity)
        return _discretisation(self.fine_mesh, self.method).flow(fields, self.tau)


_discretisation = per_mesh(Discretisation)  # one memory for all flows on a mesh


def advect(mesh: MeshLike, velocity: ArrayLike, f: ArrayLike, t: float) -> FloatArray:
    """Carry ``f`` (V,) or (V, C), by vertices of the mesh or of its file, along a field (F, 3) for
    a time of either sign, in the same shape: ``exp(-t D_v) f`` (Eq. 4), see `Flow.push`.
    """
    mesh = as_mesh(mesh)
    return Flow(mesh, check_field(mesh, velocity, "velocity")).push(f, t)

"""The flow of fields: functions advected along it, and the maps of its points."""

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
    """Yield the map of `Flow.point_map` for each of T times.

    Points continue from the map of the previous time if that time is smaller. This requires that
    they move forward, or backward along a single field.
    """
    mesh, points = lines.mesh, None
    from_time, went_ahead = 0.0, False
    for time in times.tolist():
        ahead, until = inverse != (time < 0), abs(time)
        continues = went_ahead is ahead and from_time <= until
        if not continues or not (ahead or len(lines.fields) == 1):
            points, from_time = None, 0.0
        begin, end = (from_time, until) if ahead else (until, from_time)
        points = lines.between(points, begin, end)
        from_time, went_ahead = until, ahead
        yield PointMap.of_points(mesh, points, map_of_points(lines, time, inverse))


def map_of_points(lines: ContinuousFlow, time: float, inverse: bool) -> SurfaceMap:
    ahead = inverse != (time < 0)
    return partial(lines.destinations if ahead else lines.origins, t=abs(time))


class Flow:
    """The flow of one tangent field, or of N consecutive fields, each for ``tau / N``.

    A function is advected by ``f_t = exp(-t D_v) f`` (Eq. 4), which solves ``df/dt + <v, grad f> =
    0``: its values move with the field. With several fields, the last one continues beyond ``tau``.
    A negative time undoes the flow. Exponentials are undone exactly. Linearised steps are undone by
    the same steps with the opposite sign in reverse order, which is not an exact inverse.

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
        normal part is dropped. Arrays (4^k F, 3) or (N, 4^k F, 3), such as ``match.fine_velocity``,
        are fields on the mesh subdivided k times. Functions are then interpolated and advected on
        that mesh, and returned at the vertices of the mesh itself.
    method : "nonlinear" or "linearised"
        ``exp(-t D_v)`` (Eq. 4), or its first two terms ``id - t D_v`` (Eq. 5) with one step for
        each field. Repeat the fields for smaller steps.

    Attributes
    ----------
    velocity : (N, F, 3) array
        The fields on the mesh itself, as means over the children of each face.
    fine_velocity : (N, 4^k F, 3) array
        The fields as they were passed to the constructor.
    fine_mesh : TriangleMesh
        The mesh of ``fine_velocity``.
    refined : int
        The number k of subdivisions from ``mesh`` to ``fine_mesh``.
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
        """The mesh of `fine_velocity`."""
        return refined(self.mesh, self.refined)

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields on the mesh itself, (N, F, 3)."""
        return mean_of_children(self.fine_velocity, len(self.mesh.faces))

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies without cached values, which can be recomputed."""
        left_out = ("_advection", "_lines")
        return {name: value for name, value in self.__dict__.items() if name not in left_out}

    def push(self, h: ArrayLike, t: ArrayLike | None = None) -> FloatArray:
        """Advect a function ``h`` to time ``t`` (tau by default).

        The function and the result have shape (V,) or (V, C). For T times, the result has shape (T,
        V) or (T, V, C). One pass over several times is much faster than separate calls.

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
            advected = np.stack([self._advection.at(row, moments) for row in rows], axis=-1)
        if not np.isfinite(advected).all():
            raise AdvectionError(
                "the advected function overflows; the discrete flow is unstable over this time"
            )
        advected = advected[:, : len(self.mesh.vertices)]
        return advected.reshape(*times.shape, len(self.mesh.vertices), *np.shape(h)[1:])

    def point_map(self, t: float | None = None, inverse: bool = False) -> PointMap:
        """Return the map from each vertex to the origin of its value at time ``t`` (default: tau).

        The origin is the point from which the flow advects a value to the vertex. With ``inverse``,
        the map takes each vertex to its destination. A negative time exchanges the two maps. Both
        follow the flow lines of the continuous field (`ContinuousFlow`). Beyond tau the last field
        continues.
        """
        [found] = self.point_maps([self.tau if t is None else t], inverse)
        return found

    def point_maps(self, times: ArrayLike, inverse: bool = False) -> Iterator[PointMap]:
        """Yield the maps of `point_map` for each of T times.

        For ascending times, points continue from the previous map instead of time 0 where that is
        possible.
        """
        moments = np.atleast_1d(real_numbers(times, "t", ParameterError))
        if moments.ndim != 1 or not np.isfinite(moments).all():
            raise ParameterError(f"t is {brief(times)}; expected a finite time or a list of them")
        return flow_maps(self._lines, moments, inverse)

    def coordinate_map(self, t: float | None = None) -> PointMap:
        """Return the map at time ``t`` (tau by default) by advected coordinates, as in the paper.

        The map takes each vertex to the surface point closest to the coordinates that `push`
        advects to the vertex. Discrete flows may fold this map.
        """
        return PointMap.project(self.mesh, self.mesh, self.push(self.mesh.vertices, t))

    def distortion(self, t: float | None = None) -> Distortion:
        """Measure the distortion of the map from each vertex to its destination at time ``t``.

        The default time is tau. See `PointMap.distortion`.
        """
        return self.point_map(t, inverse=True).distortion()

    def round_trip(self, t: float | None = None) -> RoundTrip:
        """Measure the error of a round trip, in mean edge lengths.

        A round trip follows the flow from 0 to ``t`` (tau by default), and back to 0. See
        `abfm.maps.round_trip`.
        """
        return self._round_trip(self.point_map(t, inverse=True), t)

    def map_quality(self, t: float | None = None) -> FlowMapQuality:
        """Measure the distortion and the round-trip error of the flow to ``t`` (tau by default)."""
        there = self.point_map(t, inverse=True)
        return FlowMapQuality(there.distortion(), self._round_trip(there, t))

    def _round_trip(self, there: PointMap, t: float | None) -> RoundTrip:
        back = map_of_points(self._lines, self.tau if t is None else t, inverse=False)
        return round_trip(there, back)

    def functional_map(self, k: int, t: float | None = None) -> FloatArray:
        """Return the flow to time ``t`` as a functional map of k eigenfunctions, shape (k, k).

        The functional map is the matrix ``Phi^+ exp(-t D_v) Phi`` (section 4 of the paper); ``t``
        is tau by default.
        """
        basis = unit_eigenbasis(self.mesh, k)[1]
        return spectral_coefficients(self.mesh, self.push(basis, t), k)

    @cached_property
    def _lines(self) -> ContinuousFlow:
        return ContinuousFlow(self.mesh, self.fine_velocity, self.tau)

    @cached_property
    def _advection(self) -> Advection:
        """The discrete flow in the mesh's unit of length; times do not depend on this unit."""
        fields = to_frame(self.fine_mesh, self.fine_velocity)
        return _discretisation(self.fine_mesh, self.method).flow(fields, self.tau)


_discretisation = per_mesh(Discretisation)  # all flows on a mesh share its memory


def advect(mesh: MeshLike, velocity: ArrayLike, f: ArrayLike, t: float) -> FloatArray:
    """Advect ``f`` along a field v (F, 3) for a time of either sign: ``exp(-t D_v) f`` (Eq. 4).

    ``D_v`` is the derivative along v. ``f`` (V,) or (V, C) has values at the vertices of the mesh
    or of its file; the result has the same shape. See `Flow.push`.
    """
    mesh = as_mesh(mesh)
    return Flow(mesh, check_field(mesh, velocity, "velocity")).push(f, t)

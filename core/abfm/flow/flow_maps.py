"""The maps that a flow makes of its surface, by the flow lines that certify matches."""

from collections.abc import Iterator
from functools import partial

from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.distortion import Map
from abfm.maps.point_maps import PointMap
from abfm.types import FloatArray


def flow_maps(lines: ContinuousFlow, times: FloatArray, inverse: bool) -> Iterator[PointMap]:
    """Map vertices to where their values came from at each of the times (T,), or, ``inverse``, to
    where they go; at negative times the other way round.

    What goes ahead, or back along a single field, goes on from the time before, if that is less.
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
        yield PointMap.of_points(mesh, points, carrying(lines, time, inverse))


def carrying(lines: ContinuousFlow, time: float, inverse: bool) -> Map:
    """Return what takes points where `flow_maps` takes vertices."""
    ahead = inverse != (time < 0)
    return partial(lines.destinations if ahead else lines.origins, t=abs(time))

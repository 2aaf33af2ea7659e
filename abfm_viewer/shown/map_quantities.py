"""What is told of a shown flow as a map of the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abfm_viewer.shown.carried import FlowState

if TYPE_CHECKING:
    from abfm.maps.quality import MapQuality
    from abfm.maps.surface_points import Distortion, SurfacePoints


def flow_distortion(flow: FlowState, time: float) -> Distortion:
    """Distortion of the map that takes each vertex to where it is at a time."""
    from abfm.maps.surface_points import distortion  # not before: it loads what the first frame does without

    return distortion(flow.mesh, _mapped(flow, -time).positions)


def flow_quality(flow: FlowState, time: float) -> MapQuality:
    """The quality of the map to where each vertex's value came from at a time; of its inverse below 0."""
    from abfm.maps.quality import map_quality

    return map_quality(flow.mesh, _mapped(flow, time))


def _mapped(flow: FlowState, time: float) -> SurfacePoints:
    from abfm.maps.surface_points import project_onto_surface

    return project_onto_surface(flow.mesh, flow.carry(flow.mesh.vertices, np.array([time]))[0])

"""What is told of a shown flow as a map of the surface."""

from __future__ import annotations

import numpy as np

import abfm
from abfm_viewer.shown.carried import FlowState


def flow_distortion(flow: FlowState, time: float) -> abfm.maps.Distortion:
    """Distortion of the map that takes each vertex to where it is at a time."""
    return abfm.maps.distortion(flow.mesh, _mapped(flow, -time).positions)


def flow_quality(flow: FlowState, time: float) -> abfm.maps.MapQuality:
    """The quality of the map to where each vertex's value came from at a time; of its inverse below 0."""
    return abfm.maps.map_quality(flow.mesh, _mapped(flow, time))


def _mapped(flow: FlowState, time: float) -> abfm.maps.SurfacePoints:
    return abfm.maps.project_onto_surface(flow.mesh, flow.carry(flow.mesh.vertices, np.array([time]))[0])

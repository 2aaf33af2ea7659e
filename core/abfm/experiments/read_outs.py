"""Ways to read a map between two poses off a flow, and the maps that the same data give without any flow.

A flow carries functions, and which map that is has to be read off them:

- carried coordinates: the closest points of A to the coordinates that the flow carries;
- the same, cut off alike: the targets are coordinates cut off at some eigenfunctions, so what was matched to them is
  looked up among A's coordinates cut off alike, which no more reach the ends of thin limbs than the targets do;
- flow lines: the start map composed with exact flow lines of the field;
- nearest neighbours: eigenfunctions of A, brought by the start map and carried by the flow, are its functional map, and
  nearest neighbours in the spectral embedding its point map.

All but the flow lines work without a flow, on the targets or the start. Only what is nearer the truth than those was
added by a flow. ZoomOut, which needs the start alone, is beside them.
"""

import numpy as np

from abfm.calculus.eigenbasis import eigenbasis
from abfm.experiments.pair import FEW, PairSetup, closest, coordinates, followed
from abfm.maps.functional_maps import functional_map, point_map, spectral_coefficients, zoom_out
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, pull_back
from abfm.matching.result import Match
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

CUT_OFF, LINES, NEIGHBOURS = ", cut off alike", ", flow lines", ", nearest neighbours"
START, NO_FLOW, ZOOM_OUT = "start", "no flow", "no flow: ZoomOut of the start"
TARGETS = "no flow: nearest surface points of the target coordinates"
_STEP = 10


def without_flow(setup: PairSetup) -> dict[str, SurfacePoints]:
    """The start, and what else the start and the targets say as they are, by name."""
    a, b, k = setup.other, setup.mesh, len(setup.wanted)
    return {
        START: setup.start,
        TARGETS: closest(setup, setup.target),
        TARGETS + CUT_OFF: closest_cut_off(setup, setup.target),
        NO_FLOW + NEIGHBOURS: point_map(a, b, functional_map(a, b, setup.start, k)),
        ZOOM_OUT: point_map(a, b, zoom_out(a, b, functional_map(a, b, setup.start, FEW), k, _STEP)),
    }


def by_flow(setup: PairSetup, name: str, found: Match) -> dict[str, SurfacePoints]:
    """The maps of a match, which began at the set-up's start, by flow lines and by nearest neighbours."""
    a, b, k = setup.other, setup.mesh, len(setup.wanted)
    basis = pull_back(a, setup.start, eigenbasis(a.normalized(), k)[1])
    C = spectral_coefficients(b, found.push(basis, found.parameters.tau), k)
    return {name + LINES: followed(setup, found.velocity), name + NEIGHBOURS: point_map(a, b, C)}


def cut_off(mesh: TriangleMesh, k: int) -> FloatArray:
    """The coordinates of `pair.coordinates` in the first k eigenfunctions, (V, 3)."""
    return np.asarray(eigenbasis(mesh.normalized(), k)[1] @ spectral_coefficients(mesh, coordinates(mesh), k))


def closest_cut_off(setup: PairSetup, functions: FloatArray) -> SurfacePoints:
    """The point map that three functions (V, 3) on B stand for, read as A's coordinates cut off as the targets are."""
    a = setup.other
    found = project_onto_surface(TriangleMesh(cut_off(a, len(setup.wanted)), a.faces), functions)
    return SurfacePoints(
        found.faces, found.barycentric, pull_back(a, found, a.vertices), found.distances * a.length_scale
    )

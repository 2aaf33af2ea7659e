"""Default source and target for a mesh that was opened without functions."""

import math

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.pages.front import front_of
from abfm.types import FloatArray

WIDTH = 0.13  # width of a Gaussian on a sufficiently fine mesh, as a fraction of sqrt(area)
_WIDTH_EDGES = 3.0
"""Width of a Gaussian on a coarser mesh, in edges, as if all triangles were equilateral."""
_WIDTH_EDGES_MAX = 4.0
"""Width in edges of the mesh itself above which Gaussians are narrowed, at most to `WIDTH`."""
_WIDTH_EDGES_MIN = 2.0  # width in edges of the mesh itself below which Gaussians are widened
_SOURCE_POSITION = 0.42
"""Position of the source on the longest geodesic, from 0 at one end to 1 at the other."""
_TARGET_DISTANCE = 0.5
"""Distance of the target from the source, in widths.

More distant targets are also matched, but by maps that change areas a lot, for example where limbs
meet the body.
"""
_FACING_WEIGHT = 0.1  # weight of vertices that face the viewer, as a share of the longest geodesic
_AVERAGED_VERTICES = 3000  # number of vertices in the sample for averages
_TILT = np.array([0.02, -0.01, 0.005])


def default_functions(mesh: TriangleMesh) -> tuple[str, str]:
    """Return the texts of two Gaussians on the mesh, as default source and target.

    Both lie near a very long geodesic of the mesh, for example from a foot to a hand. The source is
    near its middle, for example on the trunk. The target is farther along it, but so close that a
    first match changes areas little. Both preferably face a viewer who looks from
    `front_of(mesh)`. Gaussians that span less than two edges, as on coarse meshes or sliver
    triangles, are widened.
    """

    def distance(vertex: np.intp) -> FloatArray:
        return abfm.calculus.geodesic_distance(mesh, [int(vertex)])

    unit, normals = mesh.length_scale, abfm.functions.vertex_normals(mesh)
    if mesh.is_inside_out:
        normals = -normals
    facing = _facing(mesh, normals)
    # distances from both ends of the geodesic, whatever the order of the vertices
    areas = abfm.calculus.vertex_areas(mesh)
    places = mesh.vertices - areas @ mesh.vertices / areas.sum()
    tilt = places @ _TILT  # selects one of two symmetric ends, such as hands
    outermost = np.argmax(np.linalg.norm(places, axis=1) + tilt)
    from_one_end = distance(np.argmax(distance(outermost) + tilt))
    from_other_end = distance(np.argmax(from_one_end + tilt))
    length = from_one_end.max()
    place = from_one_end / (from_one_end + from_other_end)
    detour = (from_one_end + from_other_end) / length - 1
    source = np.argmin(np.abs(place - _SOURCE_POSITION) + detour - _FACING_WEIGHT * facing)
    from_source = distance(source)
    alike = facing + normals @ normals[source]

    def target_at(separation: float) -> np.intp:
        off = np.abs(from_source - separation) / length
        backwards = np.maximum(_SOURCE_POSITION + separation / length - place, 0)
        return np.argmin(off + backwards + 0.5 * detour - 0.5 * _FACING_WEIGHT * alike)

    edge = np.sqrt(4 / np.sqrt(3) / len(mesh.faces))  # of equilateral triangles, unit sqrt(area)
    width = max(_WIDTH_EDGES * edge, WIDTH)
    target = target_at(_TARGET_DISTANCE * width * unit)
    distances = np.stack([from_source, distance(target)], axis=1) / unit
    spans = abfm.matching.resolution(mesh, np.exp(-0.5 * (distances / width) ** 2))
    if spans > _WIDTH_EDGES_MAX:
        width = min(width, max(WIDTH, width * _WIDTH_EDGES_MAX / spans))
    elif spans < _WIDTH_EDGES_MIN:
        width *= _WIDTH_EDGES_MIN / spans
    target = target_at(_TARGET_DISTANCE * width * unit)
    text = "gaussian:vertex={},width={:.2g}"
    return text.format(mesh.vertex_ids[source], width), text.format(mesh.vertex_ids[target], width)


def _facing(mesh: TriangleMesh, normals: FloatArray) -> FloatArray:
    """Return how much each vertex and its surroundings face the viewer, (V,), as a cosine.

    It is the smaller of two cosines: that of the vertex, and the mean of the vertices around it.
    The mean is over a sample without vertices on the opposite side of thin parts. ``normals`` (V,
    3) point outward.
    """
    from scipy.spatial import KDTree  # imported late: the first frame does not need it

    at_vertex: FloatArray = normals @ front_of(mesh).direction
    sample = np.arange(0, len(at_vertex), -(-len(at_vertex) // _AVERAGED_VERTICES))
    neighbours = min(len(sample), math.ceil(math.pi * WIDTH**2 * len(sample)))
    tree = KDTree(mesh.vertices[sample])
    nearest = tree.query(mesh.vertices[sample], k=neighbours)[1]
    around = sample[nearest.reshape(len(sample), neighbours)]
    same_side = (normals[around] * normals[sample, None]).sum(axis=2) > 0
    averages = (at_vertex[around] * same_side).sum(axis=1) / np.maximum(same_side.sum(axis=1), 1)
    return np.asarray(np.minimum(at_vertex, averages[tree.query(mesh.vertices)[1]]))

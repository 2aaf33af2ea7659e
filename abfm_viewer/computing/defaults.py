"""What any mesh begins with: a source and a target to match."""

import math

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.pages.front import best_front
from abfm.types import FloatArray

WIDTH = 0.13
"""How wide a Gaussian is, if the mesh is fine enough, as a fraction of sqrt(area)."""
_WIDTH_EDGES = 3.0
_WIDTH_EDGES_MAX = 4.0
_WIDTH_EDGES_MIN = 2.0
"""How many edges of even triangles one is wide on coarser meshes, else no flow of theirs would be
exact; how many of the mesh's own suffice; and below how many they are wider."""
_PLACE = 0.42
"""Where the source is on the way from end to end."""
_TARGET_DISTANCE = 0.5
"""How far the target is from the source, in widths: farther ones are matched as well, by maps that
change areas a lot, as where limbs meet the body."""
_SIDE = 0.1  # how much of the way facing the viewer is worth
_AVERAGED_VERTICES = 3000  # vertices to average over
_TILT = np.array([0.02, -0.01, 0.005])


def default_functions(mesh: TriangleMesh) -> tuple[str, str]:
    """Specs of two Gaussians on the way from one end of the body to the other, on one side of it.

    The way is (nearly) the longest geodesic, such as from a foot to a hand, and the source is near
    its middle, on the trunk. The target is so near that a first match changes areas little, further
    along the way. Both rather face the viewer, who looks from `best_front(mesh)`. On a mesh so
    coarse, or of such needles, that Gaussians span hardly an edge, they are wider.
    """

    def distance(vertex: np.intp) -> FloatArray:
        return abfm.calculus.geodesic_distance(mesh, [int(vertex)])

    unit, normals = mesh.length_scale, abfm.functions.vertex_normals(mesh)
    if mesh.is_inside_out:
        normals = -normals
    facing = _facing(mesh, normals)
    # from two vertices as far apart as nearly any, whatever number which vertex has
    areas = abfm.calculus.vertex_areas(mesh)
    places = mesh.vertices - areas @ mesh.vertices / areas.sum()
    tilt = places @ _TILT  # of two ends that are alike, as hands are, always the same one is taken
    outermost = np.argmax(np.linalg.norm(places, axis=1) + tilt)
    from_one_end = distance(np.argmax(distance(outermost) + tilt))
    from_other_end = distance(np.argmax(from_one_end + tilt))
    length = from_one_end.max()
    place = from_one_end / (from_one_end + from_other_end)
    detour = (from_one_end + from_other_end) / length - 1
    source = np.argmin(np.abs(place - _PLACE) + detour - _SIDE * facing)
    from_source = distance(source)
    alike = facing + normals @ normals[source]

    def target_at(apart: float) -> np.intp:
        off = np.abs(from_source - apart) / length
        backwards = np.maximum(_PLACE + apart / length - place, 0)
        return np.argmin(off + backwards + 0.5 * detour - 0.5 * _SIDE * alike)

    edge = np.sqrt(4 / np.sqrt(3) / len(mesh.faces))  # of even triangles, in the unit of lengths
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
    """Return how much (V,) a vertex looks at the viewer, or a Gaussian around it if that is less.

    The latter is averaged over a few vertices, whose places tell what is near; another side of a
    thin part is not.
    """
    from scipy.spatial import KDTree  # not before: the window is drawn without

    own: FloatArray = normals @ best_front(mesh).direction
    few = np.arange(0, len(own), -(-len(own) // _AVERAGED_VERTICES))
    near = min(len(few), math.ceil(math.pi * WIDTH**2 * len(few)))
    tree = KDTree(mesh.vertices[few])
    around = few[tree.query(mesh.vertices[few], k=near)[1].reshape(len(few), near)]
    same_side = (normals[around] * normals[few, None]).sum(axis=2) > 0
    averages = (own[around] * same_side).sum(axis=1) / np.maximum(same_side.sum(axis=1), 1)
    facing: FloatArray = np.minimum(own, averages[tree.query(mesh.vertices)[1]])
    return facing

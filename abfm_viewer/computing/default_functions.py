"""A source and a target for any mesh, so that there is something to match at once, and to look
at.
"""

import math

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.fronts import best_front

WIDTH, _WIDEST = 0.13, 0.5
"""How wide a Gaussian is, if the mesh is fine enough, and at most, as a share of the way between
the two.
"""
_EDGES, _SPANNED, _FEWEST = 6.0, 4.0, 2.0
"""How many edges of even triangles one is wide on coarser meshes, else no flow of theirs would be
exact; how many of the mesh's own suffice; and below how many the two are put farther apart, which
makes room for wider ones."""
_PLACE = 0.34
"""Where the source is on the way from end to end."""
_APART, _FARTHEST = (0.3, 0.42), (0.5, 0.7)
"""How far the target is from the source, as shares of that way and at most; the same on meshes
too coarse for it.
"""
_SIDE = 0.1  # how much of the way facing the viewer is worth

_FEW = 3000  # vertices to average over
_TILT = np.array([0.02, -0.01, 0.005])


def default_functions(mesh: TriangleMesh) -> tuple[str, str]:
    """Specs of two Gaussians on the way from one end of the body to the other, on the same side of
    it.

    The way is (nearly) the longest geodesic, such as from a foot to a hand. A third of it lies
    before the source, which is then at a knee and not in a fork between limbs, and a third behind
    the target, unless that would be far. Both rather face the viewer, who looks from
    `best_front(mesh)`. On a mesh so coarse, or of such needles, that Gaussians between which there
    is room span hardly an edge, they are farther apart and wider.
    """
    unit, normals = mesh.length_scale, abfm.functions.vertex_normals(mesh)
    if mesh.is_inside_out:
        normals = -normals
    facing = _facing(mesh, normals)
    from_one_end, from_other_end = _from_both_ends(mesh)
    length = from_one_end.max()
    place = from_one_end / (from_one_end + from_other_end)
    detour = (from_one_end + from_other_end) / length - 1
    source = int(np.argmin(np.abs(place - _PLACE) + detour - _SIDE * facing))
    from_source = abfm.calculus.geodesic_distance(mesh, [source])
    alike = facing + normals @ normals[source]

    def target_at(apart: float) -> int:
        off = np.abs(from_source - apart) / length
        backwards = np.maximum(_PLACE + apart / length - place, 0)
        return int(np.argmin(off + backwards + 0.5 * detour - 0.5 * _SIDE * alike))

    edge = np.sqrt(4 / np.sqrt(3) / len(mesh.faces))  # of even triangles, in the unit of lengths
    nearest, farthest = (
        min(share * length, most * unit) for share, most in zip(_APART, _FARTHEST, strict=True)
    )
    width, target = min(max(_EDGES * edge, WIDTH), _WIDEST * nearest / unit), target_at(nearest)
    distances = (
        np.stack([from_source, abfm.calculus.geodesic_distance(mesh, [target])], axis=1) / unit
    )
    spans = abfm.matching.resolution(mesh, np.exp(-0.5 * (distances / width) ** 2))
    if spans > _SPANNED:
        width = min(width, max(WIDTH, width * _SPANNED / spans))
    elif spans < _FEWEST:
        apart = min(width * _SPANNED / spans * unit / _WIDEST, farthest)
        width, target = _WIDEST * apart / unit, target_at(apart)
    one, other = (
        f"gaussian:vertex={mesh.vertex_ids[vertex]},width={width:.2g}"
        for vertex in (source, target)
    )
    return one, other


def _facing(mesh: TriangleMesh, normals: FloatArray) -> FloatArray:
    """Return how much (V,) a vertex looks at the viewer, or, if that is less, what a Gaussian
    around it covers does.

    The latter is averaged over a few vertices, whose places tell what is near; another side of a
    thin part is not.
    """
    from scipy.spatial import KDTree  # not before: the window is drawn without

    own: FloatArray = normals @ best_front(mesh).direction
    few = np.arange(0, len(own), -(-len(own) // _FEW))
    near = min(len(few), math.ceil(math.pi * WIDTH**2 * len(few)))
    tree = KDTree(mesh.vertices[few])
    around = few[tree.query(mesh.vertices[few], k=near)[1].reshape(len(few), near)]
    same_side = (normals[around] * normals[few, None]).sum(axis=2) > 0
    averages = (own[around] * same_side).sum(axis=1) / np.maximum(same_side.sum(axis=1), 1)
    facing: FloatArray = np.minimum(own, averages[tree.query(mesh.vertices)[1]])
    return facing


def _from_both_ends(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    """Distances (V,) from two vertices as far apart as nearly any, whatever number which vertex
    has.
    """
    areas = abfm.calculus.vertex_areas(mesh)
    places = mesh.vertices - areas @ mesh.vertices / areas.sum()
    tilt = places @ _TILT  # of two ends that are alike, as hands are, always the same one is taken
    outermost = int(np.argmax(np.linalg.norm(places, axis=1) + tilt))
    one_end = int(np.argmax(abfm.calculus.geodesic_distance(mesh, [outermost]) + tilt))
    from_one_end = abfm.calculus.geodesic_distance(mesh, [one_end])
    return from_one_end, abfm.calculus.geodesic_distance(
        mesh, [int(np.argmax(from_one_end + tilt))]
    )

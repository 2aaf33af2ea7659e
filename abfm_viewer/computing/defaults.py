"""What any mesh begins with: a direction to look from, and a source and a target to match."""

import math

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Front, triple
from abfm_viewer.document.film import Film

_FACES_LOOKED_AT = 10_000
_AZIMUTHS, _ELEVATIONS = np.radians(np.arange(0, 360, 10)), np.radians([0, 12, 25, -12, 55])
# only for what lies flat, and only where it shows much more
_STEEP, _STEEP_COSTS = np.radians(30), 0.2
_FLAT = 0.5  # of its smaller width: what is lower lies flat
_SIDES = np.array([0.001, 0.002, 0.25])
"""What looking from the right, from above and at the face is worth, of the surface that the best
direction shows. The first two only decide between directions that show alike."""

WIDTH = 0.13
"""How wide a Gaussian is, if the mesh is fine enough, as a fraction of sqrt(area)."""
_EDGES, _SPANNED, _FEWEST = 3.0, 4.0, 2.0
"""How many edges of even triangles one is wide on coarser meshes, else no flow of theirs would be
exact; how many of the mesh's own suffice; and below how many they are wider."""
_PLACE = 0.42
"""Where the source is on the way from end to end."""
_APART = 0.5
"""How far the target is from the source, in widths: farther ones are matched as well, by maps that
change areas a lot, as where limbs meet the body."""
_SIDE = 0.1  # how much of the way facing the viewer is worth
_FEW = 3000  # vertices to average over
_TILT = np.array([0.02, -0.01, 0.005])


_MOST_LOOKED_AT = 50_000_000  # numbers of a film


def best_front(
    mesh: TriangleMesh,
    *functions: FloatArray,
    up: str = "y",
    changes: FloatArray | None = None,
) -> Front:
    """Look from where much surface is seen, and of every function (V,) its remarkable part.

    That is where it differs from its median; hiding behind another part is not considered, but of a
    surface that is inside out the outside is looked at. Without functions rather from the side that
    most meshes have in front, z where y is `up`: as much of a closed surface is seen from behind.
    Of a film its `changes` (V,) are seen, 0 or more, see `changes_in_time`.
    """
    axes = np.roll(np.eye(3), 1 - "xyz".index(up), axis=0)  # sideways, up, to the front
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(_AZIMUTHS, _ELEVATIONS))
    around = np.stack([np.sin(azimuth), np.zeros(len(azimuth)), np.cos(azimuth)], axis=1) @ axes
    directions = np.cos(elevation)[:, None] * around + np.sin(elevation)[:, None] * axes[1]
    ups = np.cos(elevation)[:, None] * axes[1] - np.sin(elevation)[:, None] * around
    faces = mesh.faces[:: max(1, len(mesh.faces) // _FACES_LOOKED_AT)]
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    outward = -1 if mesh.is_inside_out else 1
    facing = np.maximum(outward * np.cross(b - a, c - a) @ directions.T, 0)
    weights = [np.abs(f - np.median(f))[faces].mean(axis=1) for f in functions]
    if changes is not None and changes.any():
        weights.append(changes[faces].mean(axis=1))
    # how much of them each direction shows, relative to the best one
    seen = [weight @ facing for weight in (np.ones(len(faces)), *weights)]
    shares = [each / max(float(each.max()), 1e-300) for each in seen]
    width, height, depth = np.ptp(mesh.vertices @ axes.T, axis=0)
    costs = np.where(
        elevation > _STEEP, _STEEP_COSTS if height < _FLAT * min(width, depth) else np.inf, 0.0
    )
    costs -= 0.0 if weights else directions @ (_SIDES @ axes)
    best = np.argmax(np.min(shares, axis=0) + 0.2 * shares[0] - costs)
    return Front(triple(directions[best]), triple(ups[best]))


def changes_in_time(frames: FloatArray) -> FloatArray:
    """Return the variance in time of frames (T, V, C), (V,): of each channel as a share of its
    largest, and of none that is not finite. Of very long films only some frames count.
    """
    shown = frames[:: -(-frames.size // _MOST_LOOKED_AT)]
    shown = shown if len(shown) > 1 else frames
    with np.errstate(all="ignore"):
        mean = sum(frame / len(shown) for frame in shown)
        variance = np.asarray(sum((frame - mean) ** 2 / len(shown) for frame in shown))
    variance = np.where(np.isfinite(variance), variance, 0.0)
    return np.asarray((variance / np.maximum(variance.max(axis=0), 1e-300)).sum(axis=1))


def front_of_film(film: Film, up: str = "y") -> Front:
    """Look from where most of what changes in time is seen, where it was measured."""
    changes = changes_in_time(film.frames.values)
    if (unknown := film.frames.unknown) is not None:
        changes[unknown] = 0.0
    return best_front(film.frames.mesh, up=up, changes=changes)


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
    width = max(_EDGES * edge, WIDTH)
    target = target_at(_APART * width * unit)
    distances = np.stack([from_source, distance(target)], axis=1) / unit
    spans = abfm.matching.resolution(mesh, np.exp(-0.5 * (distances / width) ** 2))
    if spans > _SPANNED:
        width = min(width, max(WIDTH, width * _SPANNED / spans))
    elif spans < _FEWEST:
        width *= _FEWEST / spans
    target = target_at(_APART * width * unit)
    text = "gaussian:vertex={},width={:.2g}"
    return text.format(mesh.vertex_ids[source], width), text.format(mesh.vertex_ids[target], width)


def _facing(mesh: TriangleMesh, normals: FloatArray) -> FloatArray:
    """Return how much (V,) a vertex looks at the viewer, or a Gaussian around it if that is less.

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

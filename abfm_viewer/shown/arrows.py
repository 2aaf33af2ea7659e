"""Arrows of a field on a surface: evenly spread, none over another, whole wherever they are seen.

They lie about places that stay the same whatever the field is, and are no longer than these are
apart, so that each has a disc of its own. An eye gets places whose discs it sees; those in plain
sight stay the same while the surface turns. All lengths are in square roots of the surface's area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.pages.film_motion import OPACITY_MIN
from abfm.types import BoolArray, FloatArray, IntArray
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.ribbons import normals_at, outward

_SPACING_MAX = 0.13  # are places from each other, however small the picture
# pixels between them at the least and the largest density
_SPARSE_PIXELS = 60.0
_DENSE_PIXELS = 15.0
_LEVELS = 2  # of spacings, from one to its double: zooming changes arrows no more often
_LENGTH_MAX = 0.92  # arrow, of the distance between places
_SPEED_SHARE_MIN = 0.25  # of the longest: what is slower has none
# half widths, of that distance
_SHAFT = 0.055
_HEAD = 0.165
# of that distance, and of the arrow
_HEAD_LENGTH = 0.36
_MOST_HEAD = 0.55
# width of a rim, of that distance; and at the tip, of that width
_RIM_WIDTH = 0.035
_TIP_RIM_RATIO_MAX = 2.0
_WIDTH_SHARE_MIN = 0.6  # of the widths, where arrows are short
_SHAFT_NODES = 8
_HEAD_NODES = 6
# of that distance: above the surface, which bends
_HEIGHT = 0.04
_RIM_HEIGHT = 0.025
_HEIGHT_MAX = 0.0024
_RIM_MAX = 0.0015
# of that distance, and at most: what is less far before a place
_DEPTH_SHARE = 0.13
_DEPTH_MAX = 0.008
_VIEW_COSINE_MIN = 0.3  # cosine of the angle at which arrows are seen, near outlines
# cosine of the angle by which the surface turns between an arrow's middle and ends
_TURN_COSINE_MIN = 0.6
# of their distance: how near to each other places are of which some are chosen
_CANDIDATE_SPACING = 0.5
_DIRECTIONS = 8  # directions in which a disc is looked at


@dataclass(frozen=True)
class ArrowLook:
    """How long the longest may be, how far apart their middles are, and the speed from which on
    arrows are the longest; 0 for the field's own `abfm.calculus.fast_speed`.
    """

    length: float
    spacing: float
    fast: float = 0.0


def arrow_spacing(density: float, scale: float) -> float:
    """Return how far apart arrows are at a density, 0 to 1, in a picture with so many pixels for a
    length of 1: about as many pixels whether a surface is large or small.
    """
    pixels = _SPARSE_PIXELS * (_DENSE_PIXELS / _SPARSE_PIXELS) ** min(max(density, 0.0), 1.0)
    level = round(_LEVELS * math.log2(pixels / max(scale, 1e-300))) / _LEVELS
    return float(min(max(2.0**level, abfm.maps.SPACING_MIN), _SPACING_MAX))


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows on a surface, each straight over the faces: feet, middles and tips (A, 3, 3); and what
    is drawn of them, M vertices each, with faces (T, 3) of all and which of these are of rims.
    """

    mesh: TriangleMesh
    look: ArrowLook
    ways: FloatArray
    vertices: FloatArray  # (A, M, 3), on the surface
    normals: FloatArray  # (A, M, 3), there
    heights: FloatArray  # (M,), how far above it they are drawn
    faces: IntArray
    rims: BoolArray  # (T,)
    opacities: FloatArray  # (A,), from 0 to 1

    def turned(self, eye: Eye) -> FloatArray:
        """Return the least cosine of the angle at which each arrow is seen, (A,), negative where it
        looks away; of a surface with boundary both sides are seen.
        """
        cosines = (self.normals * eye.towards(self.vertices)).sum(axis=2)
        return np.asarray((cosines * self._sides(eye)).min(axis=1))

    def hidden(self, eye: Eye) -> BoolArray:
        """Tell which of them other parts of the surface hide, or a part of them, (A,)."""
        cosines = self.turned(eye)
        hidden = cosines <= _VIEW_COSINE_MIN
        places = self._lifted(eye)[~hidden]
        surface = self.mesh.vertices / self.mesh.length_scale, self.mesh.faces
        slopes = np.repeat(cosines[~hidden], places.shape[1])
        slack = _slack(self.look.spacing)
        covered = eye.hides(surface, places.reshape(-1, 3), slopes, slack)
        hidden[~hidden] = covered.reshape(places.shape[:2]).any(axis=1)
        return hidden

    def seen(self, eye: Eye, hidden: BoolArray | None = None) -> FloatArray:
        """Return the vertices to be drawn, (A M, 3): arrows that an outline would cut, and those
        that are known to be hidden, are drawn as points.
        """
        is_gone = self.turned(eye) <= _VIEW_COSINE_MIN
        if hidden is not None:
            is_gone |= hidden
        points = self.ways[:, 1:2]
        return np.where(is_gone[:, None, None], points, self._lifted(eye)).reshape(-1, 3)

    def _lifted(self, eye: Eye) -> FloatArray:
        """Return the vertices (A, M, 3) above the surface, on the side that the eye sees."""
        above = self.heights[:, None] * self.normals
        return np.asarray(self.vertices + self._sides(eye)[..., None] * above)

    def _sides(self, eye: Eye) -> FloatArray:
        """Return which sides the eye sees, (A, 1): 1, or -1 where a surface has boundary."""
        if self.mesh.is_closed:
            return np.ones((len(self.ways), 1))
        cosines = (self.normals * eye.towards(self.vertices)).sum(axis=2)
        return np.where(cosines.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)


def arrows_of(
    mesh: TriangleMesh,
    velocity: FloatArray,
    look: ArrowLook,
    eye: Eye | None = None,
    determined: FloatArray | None = None,
) -> Arrows:
    """Find the arrows of a field (F, 3) about `places`.

    Their lengths are as speeds are, up to the one that counts as fast; much slower places have
    none. Their opacities are how well the field is ``determined``, (F,), from 0 to 1; places where
    it hardly is have none.
    """
    speed = np.linalg.norm(velocity, axis=1)
    fast = look.fast or abfm.calculus.fast_speed(mesh, speed)
    relative = velocity / (fast or 1.0)
    points = places(mesh, look.spacing, eye)
    vectors = abfm.flow.vectors_at(mesh, relative, points)
    if fast > 0 and not vectors.any():  # what moves is smaller than the distance between arrows
        points = abfm.maps.SurfacePoints(mesh, speed.argmax(keepdims=True), np.full((1, 3), 1 / 3))
        vectors = relative[points.faces]
    speed_there = np.linalg.norm(vectors, axis=1)
    opacities = np.ones(len(points.faces)) if determined is None else determined[points.faces]
    kept = np.flatnonzero((speed_there > _SPEED_SHARE_MIN) & (opacities > OPACITY_MIN))
    along = vectors[kept] / speed_there[kept, None]
    lengths = min(look.length, _LENGTH_MAX * look.spacing) * np.minimum(speed_there[kept], 1)
    return _drawn(points[kept], along, lengths, look, opacities[kept])


def places(mesh: TriangleMesh, spacing: float, eye: Eye | None = None) -> abfm.maps.SurfacePoints:
    """Return points of which no two are nearer than a spacing, while every place is about as near
    to one of them: for an eye first those around which it sees most of a disc, that is flat enough.
    """
    spread = abfm.maps.spread_points(mesh)
    if eye is None:
        return spread.with_spacing(spacing)
    finer = np.arange(spread.count(_CANDIDATE_SPACING * spacing))
    sights = _sights(spread.points[finer], spacing / 2, eye)
    # what is not seen is there nevertheless, as the surface may turn
    candidates = finer[(sights > 0) | (finer < spread.count(spacing))]
    order = candidates[np.argsort(-sights[candidates], kind="stable")]
    return spread.points[spread.thinned(order, spacing)]


def _sights(points: abfm.maps.SurfacePoints, radius: float, eye: Eye) -> IntArray:
    """Count of discs about points (P,) in how many directions an eye sees them, (P,); 0 where it
    does not see the middle.
    """
    mesh, count = points.mesh, len(points.faces)
    frames = abfm.calculus.face_frames(mesh)[points.faces]
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    circle = radius * mesh.length_scale * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ways = np.einsum("ak,pkx->pax", circle, frames).reshape(-1, 3)
    ends, inside = abfm.flow.straightest_geodesics(
        mesh, points[np.repeat(np.arange(count), _DIRECTIONS)], ways
    )
    at = [
        (each.positions / mesh.length_scale, normals_at(mesh, each.faces, each.barycentric))
        for each in (points, ends)
    ]
    discs, normals = (
        np.concatenate([middle[:, None], around.reshape(count, _DIRECTIONS, 3)], axis=1)
        for middle, around in zip(*at, strict=True)
    )
    seen = _is_flat(normals)
    seen[:, 1:] &= inside.reshape(count, _DIRECTIONS)
    cosines = (normals * eye.towards(discs)).sum(axis=2)
    if not mesh.is_closed:
        cosines *= np.where(cosines[:, :1] < 0, -1.0, 1.0)
    seen &= cosines > _VIEW_COSINE_MIN
    surface = mesh.vertices / mesh.length_scale, mesh.faces
    lifted = discs[seen] + _HEIGHT_MAX * eye.towards(discs[seen])
    seen[seen] = ~eye.hides(surface, lifted, cosines[seen], _slack(2 * radius))
    return np.asarray(seen[:, 0] * (1 + seen[:, 1:].sum(axis=1)))


def _slack(spacing: float) -> float:
    """Return how far before a place on a surface what is seen still lies on it."""
    return min(_DEPTH_SHARE * spacing, _DEPTH_MAX)


def _is_flat(normals: FloatArray) -> BoolArray:
    """Tell of normals (A, M, 3), a middle's first, which ones hardly turn from it, (A, M)."""
    return np.asarray((normals * normals[:, :1]).sum(axis=2) > _TURN_COSINE_MIN)


def _drawn(
    points: abfm.maps.SurfacePoints,
    along: FloatArray,
    lengths: FloatArray,
    look: ArrowLook,
    opacities: FloatArray,
) -> Arrows:
    """Draw arrows of lengths and opacities (A,) about points (A,) in directions (A, 3), on the
    surface.
    """
    mesh = points.mesh
    scale, normals = mesh.length_scale, abfm.calculus.face_normals(mesh)[points.faces]
    shape, heights, faces, rims = _glyphs(lengths, look.spacing)
    ends = np.zeros((len(lengths), 2, 2))
    ends[:, 0, 0], ends[:, 1, 0] = -lengths / 2, lengths / 2
    places = np.concatenate([ends, shape], axis=1)
    across = np.cross(normals, along)
    ways = scale * (places[..., :1] * along[:, None] + places[..., 1:] * across[:, None])
    count, each = places.shape[:2]
    starts = points[np.repeat(np.arange(count), each)]
    stops, inside = abfm.flow.straightest_geodesics(mesh, starts, ways.reshape(-1, 3))
    whole = inside.reshape(count, each).all(axis=1)
    turned = normals_at(mesh, stops.faces, stops.barycentric).reshape(count, each, 3)
    own = normals_at(mesh, points.faces, points.barycentric)[:, None]
    # the faces' own, too: vertices' normals say little of a ridge
    facets = abfm.calculus.face_normals(mesh)[stops.faces].reshape(count, each, 3) * outward(mesh)
    for there in (turned, facets):
        whole &= _is_flat(np.concatenate([own, there], axis=1)).all(axis=1)
    at, turned = (stops.positions / scale).reshape(count, each, 3)[whole], turned[whole]
    middles = (points.positions / scale)[whole]
    vertices = len(heights) * np.arange(len(at))[:, None, None]
    return Arrows(
        mesh,
        look,
        np.stack([at[:, 0], middles, at[:, 1]], axis=1),
        at[:, 2:],
        turned[:, 2:],
        heights,
        (vertices + faces).reshape(-1, 3),
        np.tile(rims, len(at)),
        opacities[whole],
    )


def _glyphs(
    lengths: FloatArray, spacing: float
) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
    """Return arrows of lengths (A,) in the plane, (A, M, 2), about their middles along x: one over
    a larger one, which is its rim; heights (M,), faces (T, 3) and which of these are rims.
    """
    length = lengths[:, None]
    size = spacing * np.clip(np.sqrt(length / (_LENGTH_MAX * spacing)), _WIDTH_SHARE_MIN, 1)
    head, wide = np.minimum(_HEAD_LENGTH * size, _MOST_HEAD * length), _HEAD * size
    rim = np.full_like(length, _RIM_WIDTH * spacing)
    # the sides of the head, a rim farther out, meet farther on
    ahead = rim * np.minimum(np.sqrt(1 + (head / wide) ** 2), _TIP_RIM_RATIO_MAX)
    along_shaft, along_head = np.linspace(0, 1, _SHAFT_NODES), np.linspace(0, 1, _HEAD_NODES)
    corners, heights, faces, rims = [], [], [], []
    first = 0
    above, above_rim = min(_HEIGHT * spacing, _HEIGHT_MAX), min(_RIM_HEIGHT * spacing, _RIM_MAX)
    for height, more, farther in ((above_rim, rim, ahead), (above, 0 * rim, 0 * ahead)):
        neck = length - head
        whole = head + farther + more
        shaft = -more + (neck + more) * along_shaft, (_SHAFT * size + more) * np.ones(_SHAFT_NODES)
        tip = neck - more + whole * along_head, wide / head * whole * (1 - along_head)
        for x, half in (shaft, tip):
            nodes = x.shape[1]
            y = half[..., None] * np.array([-1, 0, 1])
            x = np.broadcast_to((x - length / 2)[..., None], y.shape)
            corners.append(np.stack([x, y], axis=-1).reshape(len(length), 3 * nodes, 2))
            heights.append(np.full(3 * nodes, height))
            faces.append(first + _strip(nodes))
            rims.append(np.full(len(faces[-1]), height == above_rim))
            first += 3 * nodes
    return (
        np.concatenate(corners, axis=1),
        np.concatenate(heights),
        np.concatenate(faces),
        np.concatenate(rims),
    )


def _strip(nodes: int) -> IntArray:
    """Return the faces of a strip of so many nodes with three vertices each, counterclockwise."""
    corner = (3 * np.arange(nodes - 1)[:, None] + np.arange(2)).reshape(-1, 1)
    return np.concatenate([corner + np.array([0, 3, 1]), corner + np.array([1, 3, 4])])

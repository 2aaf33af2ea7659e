"""Arrows of a field on a surface, evenly spaced and without overlaps.

The positions of the arrows do not depend on the field. An arrow is not longer than the distance
between neighbouring positions, so arrows do not touch. Positions with a visible neighbourhood are
preferred; clearly visible ones stay the same while the surface turns. All lengths are in units of
sqrt(area), the square root of the surface's area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.pages.sequence_motion import OPACITY_MIN
from abfm.types import BoolArray, FloatArray, IntArray
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.ribbons import normals_at, outward

_SPACING_MAX = 0.13  # largest spacing of arrows, in a picture of any size
# spacing in pixels at density 0 and at density 1
_SPARSE_PIXELS = 60.0
_DENSE_PIXELS = 15.0
_LEVELS = 2  # number of spacings per factor of 2; zooming changes arrows only in these steps
# The following sizes are fractions of the spacing of arrows, unless stated otherwise.
_LENGTH_MAX = 0.92
_SPEED_SHARE_MIN = 0.25  # of the fast speed; slower places have no arrow
# half widths of shaft and head
_SHAFT = 0.055
_HEAD = 0.165
_HEAD_LENGTH = 0.36
_HEAD_LENGTH_SHARE_MAX = 0.55  # of the length of the arrow
_RIM_WIDTH = 0.035
_TIP_RIM_RATIO_MAX = 2.0  # width of the rim at the tip, relative to elsewhere
_WIDTH_SHARE_MIN = 0.6  # width of a short arrow, relative to a long one
_SHAFT_NODES = 8
_HEAD_NODES = 6
# heights above the curved surface; the maxima are in sqrt(area)
_HEIGHT = 0.04
_RIM_HEIGHT = 0.025
_HEIGHT_MAX = 0.0024
_RIM_MAX = 0.0015
# depth by which the surface may lie in front of an arrow without hiding it; the maximum is in
# sqrt(area)
_DEPTH_SHARE = 0.13
_DEPTH_MAX = 0.008
_VIEW_COSINE_MIN = 0.3  # cosine between normal and line of sight; it is small near outlines
# cosine of the angle by which the normal turns between an arrow's middle and ends
_TURN_COSINE_MIN = 0.6
_CANDIDATE_SPACING = 0.5  # spacing of the points from which positions are chosen
_DIRECTIONS = 8  # number of points on a circle at which visibility is tested


@dataclass(frozen=True)
class ArrowStyle:
    """Length and speed of the longest arrow, and the spacing of the arrows' middles."""

    length: float
    spacing: float
    fast: float = 0.0  # 0: `abfm.calculus.fast_speed` of the field


def arrow_spacing(density: float, scale: float) -> float:
    """Return the spacing of arrows, in sqrt(area), for a density from 0 (sparse) to 1 (dense).

    The spacing in pixels hardly changes while the user zooms. ``scale`` is the number of pixels per
    sqrt(area).
    """
    pixels = _SPARSE_PIXELS * (_DENSE_PIXELS / _SPARSE_PIXELS) ** min(max(density, 0.0), 1.0)
    level = round(_LEVELS * math.log2(pixels / max(scale, 1e-300))) / _LEVELS
    return float(min(max(2.0**level, abfm.maps.SPACING_MIN), _SPACING_MAX))


@dataclass(frozen=True, eq=False)
class Arrows:
    """Straight arrows on a surface, and the triangles that draw them.

    A is the number of arrows, M the number of vertices of each arrow, and T that of all triangles.
    """

    mesh: TriangleMesh
    style: ArrowStyle
    spines: FloatArray  # (A, 3, 3), feet, middles and tips
    vertices: FloatArray  # (A, M, 3), on the surface
    normals: FloatArray  # (A, M, 3), of the surface at the vertices
    heights: FloatArray  # (M,), of the drawn vertices above the surface
    faces: IntArray  # (T, 3), of all arrows
    rims: BoolArray  # (T,), whether a face belongs to a rim
    opacities: FloatArray  # (A,), from 0 to 1

    def facing(self, eye: Eye) -> FloatArray:
        """Return the smallest cosine between normal and line of sight of each arrow, (A,).

        It is negative if the arrow faces away. Surfaces with boundary are visible from both sides.
        """
        cosines = (self.normals * eye.towards(self.vertices)).sum(axis=2)
        return np.asarray((cosines * self._sides(eye)).min(axis=1))

    def hidden(self, eye: Eye) -> BoolArray:
        """Return a mask (A,) of the arrows that the surface hides, completely or in part."""
        cosines = self.facing(eye)
        hidden = cosines <= _VIEW_COSINE_MIN
        places = self._lifted(eye)[~hidden]
        surface = self.mesh.vertices / self.mesh.length_scale, self.mesh.faces
        slopes = np.repeat(cosines[~hidden], places.shape[1])
        slack = _slack(self.style.spacing)
        covered = eye.hides(surface, places.reshape(-1, 3), slopes, slack)
        hidden[~hidden] = covered.reshape(places.shape[:2]).any(axis=1)
        return hidden

    def seen(self, eye: Eye, hidden: BoolArray | None = None) -> FloatArray:
        """Return the vertices to draw, (A M, 3); invisible arrows shrink to points."""
        is_invisible = self.facing(eye) <= _VIEW_COSINE_MIN
        if hidden is not None:
            is_invisible |= hidden
        points = self.spines[:, 1:2]
        return np.where(is_invisible[:, None, None], points, self._lifted(eye)).reshape(-1, 3)

    def _lifted(self, eye: Eye) -> FloatArray:
        """Return the vertices (A, M, 3), raised above the side of the surface that is visible."""
        above = self.heights[:, None] * self.normals
        return np.asarray(self.vertices + self._sides(eye)[..., None] * above)

    def _sides(self, eye: Eye) -> FloatArray:
        """Return the visible side at each arrow, (A, 1): 1 for the front, -1 for the back."""
        if self.mesh.is_closed:
            return np.ones((len(self.spines), 1))
        cosines = (self.normals * eye.towards(self.vertices)).sum(axis=2)
        return np.where(cosines.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)


def arrows_of(
    mesh: TriangleMesh,
    velocity: FloatArray,
    style: ArrowStyle,
    eye: Eye | None = None,
    determined: FloatArray | None = None,
) -> Arrows:
    """Return the arrows of a field (F, 3) at evenly spaced positions, see `places`.

    Lengths are proportional to speed, up to the style's fast speed. Opacities are ``determined``
    (F,), from 0 to 1, how well the data determine the field. Where either is small, there is no
    arrow.
    """
    speed = np.linalg.norm(velocity, axis=1)
    fast = style.fast or abfm.calculus.fast_speed(mesh, speed)
    relative = velocity / (fast or 1.0)
    points = places(mesh, style.spacing, eye)
    vectors = abfm.flow.vectors_at(mesh, relative, points)
    if fast > 0 and not vectors.any():  # the moving region is smaller than the spacing
        points = abfm.maps.SurfacePoints(mesh, speed.argmax(keepdims=True), np.full((1, 3), 1 / 3))
        vectors = relative[points.faces]
    speed_there = np.linalg.norm(vectors, axis=1)
    opacities = np.ones(len(points.faces)) if determined is None else determined[points.faces]
    shown = np.flatnonzero((speed_there > _SPEED_SHARE_MIN) & (opacities > OPACITY_MIN))
    along = vectors[shown] / speed_there[shown, None]
    lengths = min(style.length, _LENGTH_MAX * style.spacing) * np.minimum(speed_there[shown], 1)
    return _laid_out(points[shown], along, lengths, style, opacities[shown])


def places(mesh: TriangleMesh, spacing: float, eye: Eye | None = None) -> abfm.maps.SurfacePoints:
    """Return points that cover the surface, at least ``spacing`` apart, in units of sqrt(area).

    Points whose neighbourhood is visible from the viewpoint ``eye`` are chosen first.
    """
    spread = abfm.maps.spread_points(mesh)
    if eye is None:
        return spread.with_spacing(spacing)
    finer = np.arange(spread.count(_CANDIDATE_SPACING * spacing))
    sights = _sights(spread.points[finer], spacing / 2, eye)
    # invisible points are included because the surface may turn
    candidates = finer[(sights > 0) | (finer < spread.count(spacing))]
    order = candidates[np.argsort(-sights[candidates], kind="stable")]
    return spread.points[spread.thinned(order, spacing)]


def _sights(points: abfm.maps.SurfacePoints, radius: float, eye: Eye) -> IntArray:
    """Return how visible the disc of a radius about each point (P,) is, as integers (P,).

    This is 1 plus the number of visible points on its circle, or 0 if its centre is hidden.
    """
    mesh, count = points.mesh, len(points.faces)
    frames = abfm.calculus.face_frames(mesh)[points.faces]
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    circle = radius * mesh.length_scale * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rays = np.einsum("ak,pkx->pax", circle, frames).reshape(-1, 3)
    ends, inside = abfm.flow.straightest_geodesics(
        mesh, points[np.repeat(np.arange(count), _DIRECTIONS)], rays
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
    """Return how far a surface may lie in front of an arrow without hiding it, in sqrt(area)."""
    return min(_DEPTH_SHARE * spacing, _DEPTH_MAX)


def _is_flat(normals: FloatArray) -> BoolArray:
    """Return a mask (A, M) of the normals (A, M, 3) that hardly turn from the first of a row."""
    return np.asarray((normals * normals[:, :1]).sum(axis=2) > _TURN_COSINE_MIN)


def _laid_out(
    points: abfm.maps.SurfacePoints,
    along: FloatArray,
    lengths: FloatArray,
    style: ArrowStyle,
    opacities: FloatArray,
) -> Arrows:
    """Lay straight arrows on the surface; omit those that cross its boundary or bend too much.

    ``points`` (A,) are the middles of the arrows, ``along`` (A, 3) their directions, and
    ``lengths`` and ``opacities`` have shape (A,).
    """
    mesh = points.mesh
    scale, normals = mesh.length_scale, abfm.calculus.face_normals(mesh)[points.faces]
    shape, heights, faces, rims = _glyphs(lengths, style.spacing)
    ends = np.zeros((len(lengths), 2, 2))
    ends[:, 0, 0], ends[:, 1, 0] = -lengths / 2, lengths / 2
    places = np.concatenate([ends, shape], axis=1)
    across = np.cross(normals, along)
    offsets = scale * (places[..., :1] * along[:, None] + places[..., 1:] * across[:, None])
    count, each = places.shape[:2]
    starts = points[np.repeat(np.arange(count), each)]
    stops, inside = abfm.flow.straightest_geodesics(mesh, starts, offsets.reshape(-1, 3))
    fits = inside.reshape(count, each).all(axis=1)
    smooth = normals_at(mesh, stops.faces, stops.barycentric).reshape(count, each, 3)
    at_middle = normals_at(mesh, points.faces, points.barycentric)[:, None]
    # also the normals of faces: those interpolated from vertices smooth out a ridge
    facets = abfm.calculus.face_normals(mesh)[stops.faces].reshape(count, each, 3) * outward(mesh)
    for there in (smooth, facets):
        fits &= _is_flat(np.concatenate([at_middle, there], axis=1)).all(axis=1)
    at, smooth = (stops.positions / scale).reshape(count, each, 3)[fits], smooth[fits]
    middles = (points.positions / scale)[fits]
    vertices = len(heights) * np.arange(len(at))[:, None, None]
    return Arrows(
        mesh,
        style,
        np.stack([at[:, 0], middles, at[:, 1]], axis=1),
        at[:, 2:],
        smooth[:, 2:],
        heights,
        (vertices + faces).reshape(-1, 3),
        np.tile(rims, len(at)),
        opacities[fits],
    )


def _glyphs(
    lengths: FloatArray, spacing: float
) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
    """Return arrows of lengths (A,) in the plane, centred at 0 and pointing along x.

    Each arrow lies above a larger arrow, which forms its rim. The result is vertices (A, M, 2),
    their heights above the surface (M,), faces (T, 3), and a mask (T,) of the rims' faces.
    """
    length = lengths[:, None]
    size = spacing * np.clip(np.sqrt(length / (_LENGTH_MAX * spacing)), _WIDTH_SHARE_MIN, 1)
    head = np.minimum(_HEAD_LENGTH * size, _HEAD_LENGTH_SHARE_MAX * length)
    wide = _HEAD * size
    rim = np.full_like(length, _RIM_WIDTH * spacing)
    # the outer sides of the rim meet ahead of the tip
    ahead = rim * np.minimum(np.sqrt(1 + (head / wide) ** 2), _TIP_RIM_RATIO_MAX)
    along_shaft, along_head = np.linspace(0, 1, _SHAFT_NODES), np.linspace(0, 1, _HEAD_NODES)
    corners, heights, faces, rims = [], [], [], []
    first = 0
    above, above_rim = min(_HEIGHT * spacing, _HEIGHT_MAX), min(_RIM_HEIGHT * spacing, _RIM_MAX)
    for height, margin, tip_margin in ((above_rim, rim, ahead), (above, 0 * rim, 0 * ahead)):
        neck = length - head
        head_length = head + tip_margin + margin
        half_width = (_SHAFT * size + margin) * np.ones(_SHAFT_NODES)
        shaft = -margin + (neck + margin) * along_shaft, half_width
        sides = wide / head * head_length * (1 - along_head)
        tip = neck - margin + head_length * along_head, sides
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
    """Return the counterclockwise faces of a strip of ``nodes`` rows of three vertices."""
    corner = (3 * np.arange(nodes - 1)[:, None] + np.arange(2)).reshape(-1, 1)
    return np.concatenate([corner + np.array([0, 3, 1]), corner + np.array([1, 3, 4])])

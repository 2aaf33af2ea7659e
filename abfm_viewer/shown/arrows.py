"""Arrows of a field on a surface: evenly spread, none over another, whole wherever they are seen.

They are pieces of flow lines about places that stay the same whatever the field is, no longer than
these are apart: each has a disc of its own. All lengths are in square roots of the surface's area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.maps.spread_points import NEAREST
from abfm.types import BoolArray, FloatArray, IntArray
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.ribbons import normals_at, sides, strip_faces, unit

_FARTHEST = 0.13  # are places from each other, however small the picture
_SPARSE, _DENSE = 52.0, 13.0  # pixels between them at the least and the largest density
_LEVELS = 2  # of spacings, from one to its double: zooming changes arrows no more often
_LONGEST = 0.92  # arrow, of the distance between places
_SHORTEST = 0.2  # of the longest: what is slower has none
_WILD = 0.001  # of the area: speeds that no more of it has count as the next lower ones
_FAST = 0.4  # of the squared norm: what as much of it exceeds has the full length
_STEPS = 6  # of a flow line, each way
_SHAFT, _HEAD = 0.055, 0.165  # half widths, of that distance
_HEAD_LENGTH, _MOST_HEAD = 0.36, 0.55  # of that distance, and of the arrow
_RIM, _SHARPEST = 0.035, 2.0  # width of a rim, of that distance; and at the tip, of that width
_THINNEST = 0.55  # of the widths, where arrows are short
_SHAFT_NODES, _HEAD_NODES = 7, 3
_LIFT, _RIM_LIFT = 0.0026, 0.0017  # above the surface, which would hide them where it bends
_FLATTEST = 0.3  # cosine of the angle at which arrows are seen, near outlines


@dataclass(frozen=True)
class ArrowLook:
    """How long the longest may be, and how far apart their middles are."""

    length: float
    spacing: float


def arrow_spacing(density: float, scale: float) -> float:
    """Return how far apart arrows are at a density, 0 to 1, in a picture with so many pixels for a
    length of 1: about as many pixels whether a surface is large or small.
    """
    pixels = _SPARSE * (_DENSE / _SPARSE) ** min(max(density, 0.0), 1.0)
    level = round(_LEVELS * math.log2(pixels / max(scale, 1e-300))) / _LEVELS
    return min(max(2.0**level, NEAREST), _FARTHEST)


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows on a surface: ways (A, K, 3) from their feet to their tips, with normals there, and
    what is drawn of them, M vertices each, with faces (T, 3) of all and which of these are of rims.
    """

    mesh: TriangleMesh
    ways: FloatArray
    normals: FloatArray
    vertices: FloatArray  # (A, M, 3), on the surface
    lifts: FloatArray  # (A, M, 3), what brings them above it
    faces: IntArray
    rims: BoolArray  # (T,)

    @property
    def lengths(self) -> FloatArray:
        """Measure them along their ways, (A,)."""
        return np.asarray(np.linalg.norm(np.diff(self.ways, axis=1), axis=2).sum(axis=1))

    def turned(self, eye: Eye) -> FloatArray:
        """Return the least cosine of the angle at which each arrow is seen, (A,), negative where it
        looks away; of a surface with boundary both sides are seen.
        """
        cosines = (self.normals * eye.towards(self.ways)).sum(axis=2)
        if not self.mesh.is_closed:
            cosines *= np.sign(cosines[:, cosines.shape[1] // 2, None])
        return np.asarray(cosines.min(axis=1))

    def hidden(self, eye: Eye) -> BoolArray:
        """Tell which of them other parts of the surface hide, or a part of them, (A,)."""
        cosines = self.turned(eye)
        hidden = cosines <= _FLATTEST
        candidates = np.flatnonzero(~hidden)
        places = self._lifted(eye)[candidates]
        surface = self.mesh.vertices / self.mesh.length_scale, self.mesh.faces
        slopes = np.repeat(cosines[candidates], places.shape[1])
        covered = eye.hides(surface, places.reshape(-1, 3), slopes)
        hidden[candidates] = covered.reshape(places.shape[:2]).any(axis=1)
        return hidden

    def seen(self, eye: Eye, hidden: BoolArray | None = None) -> FloatArray:
        """Return the vertices to be drawn, (A M, 3): arrows that an outline would cut, and those
        that are known to be hidden, are drawn as points.
        """
        is_gone = self.turned(eye) <= _FLATTEST
        if hidden is not None:
            is_gone |= hidden
        middles = self.ways[:, self.ways.shape[1] // 2, None]
        return np.where(is_gone[:, None, None], middles, self._lifted(eye)).reshape(-1, 3)

    def _lifted(self, eye: Eye) -> FloatArray:
        """Return the vertices (A, M, 3) above the surface: on the eye's side if that has two."""
        if self.mesh.is_closed:
            return self.vertices + self.lifts
        middle = self.ways.shape[1] // 2
        side = (self.normals * eye.towards(self.ways)).sum(axis=2)[:, middle, None, None]
        return np.asarray(self.vertices + np.where(side < 0, -1, 1) * self.lifts)


def arrows_of(
    mesh: TriangleMesh, velocity: FloatArray, look: ArrowLook, fast: float = 0.0
) -> Arrows:
    """Find the arrows of a field (F, 3).

    Their lengths are as speeds are, up to the one that counts as ``fast``, by default the field's
    own `fast_speed`; much slower places have none.
    """
    spacing = look.spacing
    speed = np.linalg.norm(velocity, axis=1)
    fast = fast or fast_speed(mesh, speed)
    points = abfm.maps.spread_points(mesh).apart(spacing)
    if fast > 0 and not speed[points.faces].any():
        fastest = np.array([speed.argmax()])
        points = abfm.maps.SurfacePoints(mesh, fastest, np.full((1, 3), 1 / 3))
    longest = min(look.length, _LONGEST * spacing)
    ways = np.zeros((0, 2 * _STEPS + 1, 3))
    normals = ways
    if fast > 0:
        capped = velocity / np.maximum(fast, speed)[:, None]
        ways, normals = _ways(mesh, capped, points, longest)
    lengths = np.linalg.norm(np.diff(ways, axis=1), axis=2).sum(axis=1)
    kept = lengths > _SHORTEST * longest
    return _drawn(mesh, ways[kept], normals[kept], spacing)


def fast_speed(mesh: TriangleMesh, speed: FloatArray) -> float:
    """Return what of speeds (F,) counts as fast: faces that are faster have a good part of the
    field's squared norm, wherever that is on the surface. Those of slivers, which run wild, count
    as their lower neighbours'; 0 if all is still.
    """
    descending = np.argsort(-speed, kind="stable")
    areas = abfm.calculus.face_areas(mesh)[descending] / mesh.length_scale**2
    tame = min(int(np.searchsorted(np.cumsum(areas), _WILD)), len(speed) - 1)
    most = float(speed[descending[tame]]) or float(speed.max())
    if not most:
        return 0.0
    norms = np.cumsum(areas * np.minimum(speed[descending] / most, 1) ** 2)
    return float(min(speed[descending[np.searchsorted(norms, _FAST * norms[-1])]], most))


def _ways(
    mesh: TriangleMesh, velocity: FloatArray, points: abfm.maps.SurfacePoints, longest: float
) -> tuple[FloatArray, FloatArray]:
    """Return pieces of flow lines about points (A,) and normals on them, (A, K, 3), with the points
    halfway in time; a speed of 1 gives the greatest length.
    """
    scale = mesh.length_scale
    flow = abfm.flow.ContinuousFlow(mesh, velocity, longest * scale)
    times = np.linspace(0, longest * scale / 2, _STEPS + 1).tolist()
    before, after = [points], [points]
    for begin, end in pairwise(times):
        before.append(flow.between(before[-1], end, begin))
        after.append(flow.between(after[-1], begin, end))
    line = [*reversed(before[1:]), *after]
    places = np.stack([at.positions / scale for at in line], axis=1)
    normals = np.stack([normals_at(mesh, at.faces, at.barycentric) for at in line], axis=1)
    return _evenly(places, normals, longest)


def _evenly(
    places: FloatArray, normals: FloatArray, longest: float
) -> tuple[FloatArray, FloatArray]:
    """Divide ways (A, K, 3) evenly, and end them where half of the greatest length is walked."""
    steps = np.linalg.norm(np.diff(places, axis=1), axis=2)
    walked = np.concatenate([np.zeros((len(places), 1)), np.cumsum(steps, axis=1)], axis=1)
    walked -= walked[:, _STEPS, None]
    even = np.linspace(-1, 1, walked.shape[1])
    lows = np.maximum(walked[:, 0], -longest / 2)
    highs = np.minimum(walked[:, -1], longest / 2)
    found, turned = np.empty_like(places), np.empty_like(normals)
    for a in range(len(places)):
        at = np.where(even < 0, -even * lows[a], even * highs[a])
        for x in range(3):
            found[a, :, x] = np.interp(at, walked[a], places[a, :, x])
            turned[a, :, x] = np.interp(at, walked[a], normals[a, :, x])
    return found, unit(turned)


def _drawn(mesh: TriangleMesh, ways: FloatArray, normals: FloatArray, spacing: float) -> Arrows:
    """Draw arrows along ways (A, K, 3): a dark one over a light one, which is its rim."""
    count = len(ways)
    length = np.linalg.norm(np.diff(ways, axis=1), axis=2).sum(axis=1)[:, None]
    size = spacing * np.clip(np.sqrt(length / (_LONGEST * spacing)), _THINNEST, 1)
    head, wide = np.minimum(_HEAD_LENGTH * size, _MOST_HEAD * length), _HEAD * size
    thin, rim = _SHAFT * size, _RIM * spacing * np.ones((count, 1))
    # the sides of the head, a rim farther out, meet farther on
    ahead = rim * np.minimum(np.sqrt(1 + (head / wide) ** 2), _SHARPEST)
    along_shaft, along_head = np.linspace(0, 1, _SHAFT_NODES), np.linspace(0, 1, _HEAD_NODES)
    parts = []
    for lift, more, farther in ((_RIM_LIFT, rim, ahead), (_LIFT, 0 * rim, 0 * ahead)):
        neck, base = length - head, length - head - more
        whole = head + farther + more
        widest = wide / head * whole
        parts.append((lift, -more + (neck + more) * along_shaft, thin + more + 0 * along_shaft))
        parts.append((lift, base + whole * along_head, widest * (1 - along_head)))
    vertices, lifts, faces, rims = [], [], [], []
    corners = 0
    for number, (lift, at, half_widths) in enumerate(parts):
        places, up = _at(ways, at / length), unit(_at(normals, at / length))
        vertices.append(sides(places, up, half_widths))
        lifts.append(lift * np.repeat(up, 2, axis=1))
        faces.append(corners + strip_faces(at.shape[1]))
        rims.append(np.full(len(faces[-1]), number < 2))
        corners += 2 * at.shape[1]
    own = np.concatenate(faces)
    every = (corners * np.arange(count)[:, None, None] + own).reshape(-1, 3)
    drawn, lifted = np.concatenate(vertices, axis=1), np.concatenate(lifts, axis=1)
    return Arrows(mesh, ways, normals, drawn, lifted, every, np.tile(np.concatenate(rims), count))


def _at(values: FloatArray, shares: FloatArray) -> FloatArray:
    """Return values (A, K, x) of even ways at shares (A, n), straight on beyond their ends."""
    place = shares * (values.shape[1] - 1)
    before = np.clip(np.floor(place).astype(np.int64), 0, values.shape[1] - 2)
    rows, part = np.arange(len(values))[:, None], (place - before)[..., None]
    return np.asarray((1 - part) * values[rows, before] + part * values[rows, before + 1])

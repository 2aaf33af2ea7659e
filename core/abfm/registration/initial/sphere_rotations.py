"""The map through spheres that are given with both surfaces, turned as functions or landmarks ask.

Spheres of one atlas and another, or of a subject as it was inflated, differ by a rotation, of some
tens of degrees between atlases. It is searched for over all rotations, on averages over cells of
the sphere that get smaller, by the correlation of the functions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from abfm.maps.spherical import SphereLayout
from abfm.mesh.directions import spread_directions
from abfm.numerics.kernels import kernel
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

_ROTATIONS = 20_000  # about 9 degrees apart
_CELLS = (400, 1600, 6400)  # of the sphere, 10, 5 and 2.5 degrees wide, or as many as vertices
_REFINED_ROTATIONS = 12  # rotations that are refined
_ROTATIONS_AT_ONCE = 500  # rotations in memory
_ROTATION_ANGLE_MIN = np.radians(12)  # rotations closer than this lead to one
_START = np.radians((6, 3, 1.5))  # of the simplex, by cells
_LINES = 180  # of latitude in tables
_SIGN_WEIGHT = 0.9  # what a correlation counts whose sign is the other one
_EQUAL_CORRELATION_SHARE = 0.99  # of the best, from which on a sphere stays as it stands
_CONSTANT = 1e-9  # of a function's size: smaller deviations from its mean are rounding
_SPREAD_MIN = 1e-6  # of landmarks' directions: less leaves a rotation open


class SphereRotation(NamedTuple):
    """A rotation of sphere A, and what it comes to."""

    rotation: Rotation
    correlation: float  # of A's functions, carried, with B's, of any sign; NaN for landmarks alone
    # the largest one of rotations that are another one, over `correlation`
    runner_up: float

    @property
    def degrees(self) -> float:
        return float(np.degrees(self.rotation.magnitude()))


@dataclass(frozen=True, eq=False)
class SphereFunctions:
    """Functions on a surface that is laid out on the unit sphere.

    ``functions`` is (C, V); ``weights`` (V,), not negative, say how much vertices count.
    """

    layout: SphereLayout
    functions: FloatArray
    weights: FloatArray | None = field(default=None)

    def averaged(self, cells: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means over cells of the sphere, (C, n), by their middles (n, 3), and how much each
        counts, (n,): cells that no vertex is in take what is where their middles are.
        """
        mesh = self.layout.mesh
        corners = self.layout.directions[mesh.faces]
        spans = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.bincount(
            mesh.faces.ravel(), np.repeat(np.linalg.norm(spans, axis=1) / 6, 3), len(mesh.vertices)
        )
        weights = np.ones(len(areas)) if self.weights is None else self.weights
        cell, count = KDTree(cells).query(self.layout.directions)[1], len(cells)
        whole, counted = (np.bincount(cell, x, count) for x in (areas, areas * weights))
        sums = np.stack([np.bincount(cell, areas * weights * f, count) for f in self.functions])
        empty = whole == 0
        at_middles = self.layout.locate(cells[empty])
        whole[empty], counted[empty] = 1.0, at_middles.pull_back(weights)
        sums[:, empty] = at_middles.pull_back((weights * self.functions).T).T
        means = np.divide(sums, counted, out=np.zeros_like(sums), where=counted > 0)
        return means, counted / whole


def rotation_by_functions(
    a: SphereFunctions, b: SphereFunctions, weights: FloatArray, is_rough: bool = False
) -> SphereRotation:
    """Search all rotations of sphere A for the one whose functions correlate best with B's, in the
    mean over channels by weights (C,). The other sign, as packages differ in it, is taken where it
    is clearly better, and another rotation than none where that leaves less alike, by 1%.

    The rotation takes directions on A to directions on B. A rough one is within 9 degrees.
    """
    a, b = _scaled(a), _scaled(b)
    with step("searching for the rotation of the sphere") as report:
        vertices = min(len(each.layout.directions) for each in (a, b))
        start = _Level(a, b, weights, min(_CELLS[0], vertices))
        rotations = _spread_rotations(_ROTATIONS)
        scores = []
        for begin in range(0, len(rotations), _ROTATIONS_AT_ONCE):
            checkpoint()
            scores.append(start.correlations(rotations[begin : begin + _ROTATIONS_AT_ONCE]))
        best = _distinct(rotations, np.concatenate(scores))
        report(1 / (len(_CELLS) + 1))
        level = start
        for number, count in enumerate(() if is_rough else _CELLS):
            level = start if number == 0 else _Level(a, b, weights, min(count, vertices))
            best = [level.refined(each, _START[number]) for each in best]
            found = np.array([level.correlations(each)[0] for each in best])
            kept = _distinct(Rotation.concatenate(best), found)
            best = kept[: max(2, _REFINED_ROTATIONS // 4 ** (number + 1))]
            report((number + 2) / (len(_CELLS) + 1))
        best = _standing_first(level, best)
    last = [float(level.correlations(each)[0]) for each in best]
    reached = float(level.correlations(best[0], opposite=1.0)[0])
    return SphereRotation(
        best[0], reached, max(last[1:], default=0.0) / last[0] if last[0] > 0 else 1.0
    )


def _standing_first(level: _Level, best: list[Rotation]) -> list[Rotation]:
    """Return rotations, the best one first, with none before them if it is another and as good."""
    here = Rotation.identity()
    if best[0].magnitude() < _ROTATION_ANGLE_MIN:
        return best
    if level.correlations(here)[0] < _EQUAL_CORRELATION_SHARE * level.correlations(best[0])[0]:
        return best
    return [here, *(each for each in best if each.magnitude() > _ROTATION_ANGLE_MIN)]


def _scaled(given: SphereFunctions) -> SphereFunctions:
    """Return functions less their means, of size 1, so that no square of theirs overflows; and
    constants as 0, which correlate with nothing.
    """
    scaled = []
    for values in given.functions:
        size = np.abs(values).max()
        unit = values / size if size > 0 else values
        apart = unit - unit.mean()
        largest = np.abs(apart).max()
        scaled.append(apart / largest if largest > _CONSTANT else np.zeros_like(apart))
    return SphereFunctions(given.layout, np.array(scaled), given.weights)


def rotation_by_landmarks(
    a: SphereLayout, b: SphereLayout, pairs: Landmarks
) -> SphereRotation | None:
    """Return the rotation of sphere A that brings landmarks nearest to their partners on B; None
    where they leave it open, as they are in one place of a sphere, or in it and opposite.
    """
    here, there = a.directions_of(pairs.a), b.directions_of(pairs.b)
    for directions in (here, there):
        if np.linalg.svd(directions, compute_uv=False)[1] < _SPREAD_MIN * np.sqrt(len(pairs)):
            return None
    rotation, _ = Rotation.align_vectors(there, here, pairs.weights)
    return SphereRotation(rotation, np.nan, 0.0)


class _Level:
    """Functions of both spheres as averages over cells, and A's as tables by angles, the last one
    of how much they count.
    """

    def __init__(
        self, a: SphereFunctions, b: SphereFunctions, weights: FloatArray, count: int
    ) -> None:
        self._places = spread_directions(count)
        self._target, counted = b.averaged(self._places)
        self._weights = weights
        values, shares = a.averaged(self._places)
        places = KDTree(self._places)
        rows = np.radians(np.linspace(-90, 90, _LINES + 1))
        columns = np.radians(np.linspace(-180, 180, 2 * _LINES + 1))
        latitude, longitude = np.meshgrid(rows, columns, indexing="ij")
        grid = np.stack(
            [
                np.cos(latitude) * np.cos(longitude),
                np.cos(latitude) * np.sin(longitude),
                np.sin(latitude),
            ],
            axis=-1,
        )
        distances, near = places.query(grid.reshape(-1, 3), 3)
        shade = 1 / np.maximum(distances, 1e-6)
        shade /= shade.sum(axis=1, keepdims=True)
        self._tables = np.einsum("gk,cgk->cg", shade, np.vstack([values, shares])[:, near]).reshape(
            -1, *latitude.shape
        )
        self._counted = counted

    def correlations(self, rotations: Rotation, opposite: float = _SIGN_WEIGHT) -> FloatArray:
        """Return the mean over channels of correlations, (K,), of rotations (K) of A; negative ones
        count so much less.
        """
        back = np.ascontiguousarray(rotations.inv().as_matrix().reshape(-1, 3, 3))
        seen = np.empty((len(self._tables), len(back), len(self._places)))
        _see(back, self._places, self._tables, seen)
        counted = self._counted * np.clip(seen[-1], 0, None)
        total = np.maximum(counted.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        score = np.zeros(len(back))
        for f, target, weight in zip(seen[:-1], self._target, self._weights, strict=True):
            f = f - (counted * f).sum(axis=1, keepdims=True) / total
            g = target - (counted * target).sum(axis=1, keepdims=True) / total
            sizes = (counted * f**2).sum(axis=1) * (counted * g**2).sum(axis=1)
            products = (counted * f * g).sum(axis=1)
            alike = np.divide(
                products, np.sqrt(sizes), out=np.zeros_like(products), where=sizes > 0
            )
            score += weight * np.maximum(alike, -opposite * alike)
        # where little of both is left to compare nothing is said
        return np.asarray(score / self._weights.sum() * np.minimum(1, 2 * total[:, 0] / self._most))

    @property
    def _most(self) -> float:
        return float(min(self._counted.sum(), self._tables[-1].mean() * len(self._counted)))

    def refined(self, rotation: Rotation, size: float) -> Rotation:
        """Return the best rotation near one, by a simplex of a size in radians."""
        # late, as all that registers is loaded with this file, and few use it
        from scipy.optimize import minimize

        corners = np.vstack([np.zeros(3), size * np.eye(3)])

        def loss(vector: FloatArray) -> float:
            turned = Rotation.from_rotvec(vector) * rotation
            return -float(self.correlations(turned)[0])

        found = minimize(
            loss,
            np.zeros(3),
            method="Nelder-Mead",
            options={"initial_simplex": corners, "xatol": 1e-4, "fatol": 1e-6, "maxfev": 200},
        )
        return Rotation.from_rotvec(found.x) * rotation


@kernel
def _see(back: FloatArray, places: FloatArray, tables: FloatArray, seen: FloatArray) -> None:
    """Interpolate tables by latitude and longitude where rotations (K, 3, 3) bring places (n, 3),
    to ``seen`` (T, K, n).
    """
    _, rows, columns = tables.shape
    lines = (rows - 1) / np.pi
    for k in range(len(back)):
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = back[k]
        for n in range(len(places)):
            a, b, c = places[n]
            z = min(max(zx * a + zy * b + zz * c, -1.0), 1.0)
            row = (np.arcsin(z) + np.pi / 2) * lines
            column = (
                np.arctan2(yx * a + yy * b + yz * c, xx * a + xy * b + xz * c) + np.pi
            ) * lines
            i, j = min(int(row), rows - 2), min(int(column), columns - 2)
            up, on = row - i, column - j
            for t in range(len(tables)):
                here, there = tables[t, i], tables[t, i + 1]
                below = (1 - on) * here[j] + on * here[j + 1]
                above = (1 - on) * there[j] + on * there[j + 1]
                seen[t, k, n] = (1 - up) * below + up * above


def _spread_rotations(count: int) -> Rotation:
    """Return evenly spread rotations: super-Fibonacci spirals [Alexa, CVPR 2022]."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    parts = inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)
    return Rotation.from_quat(np.stack(parts, axis=1))


def _distinct(rotations: Rotation, scores: FloatArray) -> list[Rotation]:
    """Return rotations by descending score, without those that are like a better one."""
    kept: list[Rotation] = []
    for number in np.argsort(-scores, kind="stable")[: 60 * _REFINED_ROTATIONS]:
        one = rotations[int(number)]
        if all((one * other.inv()).magnitude() > _ROTATION_ANGLE_MIN for other in kept):
            kept.append(one)
        if len(kept) == _REFINED_ROTATIONS:
            break
    return kept

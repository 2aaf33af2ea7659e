"""Rotations between two spheres, by functions or landmarks on both.

Spheres of different atlases, or of inflated subjects, differ by a rotation of some tens of degrees.
The search covers all rotations and maximises the correlation of the functions. It uses means over
cells of the sphere, from coarse to fine.
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

_ROTATIONS = 20_000  # number of rotations that are tried, about 9 degrees apart
_CELLS = (400, 1600, 6400)  # numbers of cells, which are 10, 5 and 2.5 degrees wide
_REFINED_ROTATIONS = 12  # number of rotations that are refined
_ROTATIONS_AT_ONCE = 500  # rotations in memory at the same time
_ROTATION_ANGLE_MIN = np.radians(12)  # closer rotations count as one
_SIMPLEX_SIZES = np.radians((6, 3, 1.5))  # first size of the simplex for each number of cells
_LATITUDES = 180  # rows of tables of rotated functions
_SIGN_WEIGHT = 0.9  # factor of negative correlations
_EQUAL_CORRELATION_SHARE = 0.99  # the identity is preferred with this share of the best
_CONSTANT = 1e-9  # functions that vary less, relative to their largest value, are constant
_SPREAD_MIN = 1e-6  # landmarks whose directions vary less do not determine a rotation


class SphereRotation(NamedTuple):
    """A rotation of sphere A, and the correlation of the functions after it."""

    rotation: Rotation
    correlation: float  # absolute, of A's rotated functions with B's; NaN for landmarks only
    runner_up: float  # largest correlation of a different rotation, divided by `correlation`

    @property
    def degrees(self) -> float:
        return float(np.degrees(self.rotation.magnitude()))


@dataclass(frozen=True, eq=False)
class SphereFunctions:
    """Functions on a surface that is laid out on the unit sphere.

    ``functions`` (C, V) have values at the vertices, and ``weights`` (V,) are nonnegative weights
    of the vertices.
    """

    layout: SphereLayout
    functions: FloatArray
    weights: FloatArray | None = field(default=None)

    def averaged(self, cells: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the means of functions over cells of the sphere, (C, n), and cell weights, (n,).

        ``cells`` (n, 3) are the centres of the cells. A cell without a vertex has the values at its
        centre.
        """
        mesh = self.layout.mesh
        corners = self.layout.directions[mesh.faces]
        spans = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.bincount(
            mesh.faces.ravel(), np.repeat(np.linalg.norm(spans, axis=1) / 6, 3), len(mesh.vertices)
        )
        weights = np.ones(len(areas)) if self.weights is None else self.weights
        cell, count = KDTree(cells).query(self.layout.directions)[1], len(cells)
        total, weighted = (np.bincount(cell, x, count) for x in (areas, areas * weights))
        sums = np.stack([np.bincount(cell, areas * weights * f, count) for f in self.functions])
        empty = total == 0
        at_centres = self.layout.locate(cells[empty])
        total[empty], weighted[empty] = 1.0, at_centres.pull_back(weights)
        sums[:, empty] = at_centres.pull_back((weights * self.functions).T).T
        means = np.divide(sums, weighted, out=np.zeros_like(sums), where=weighted > 0)
        return means, weighted / total


def rotation_by_functions(
    a: SphereFunctions, b: SphereFunctions, weights: FloatArray, is_rough: bool = False
) -> SphereRotation:
    """Return the rotation of sphere A for which its functions correlate best with those of B.

    The correlation is the mean over channels with ``weights`` (C,). Negative correlations also
    count, with a factor of 0.9, because software packages differ in the sign of a function. The
    identity is preferred unless its correlation is more than 1% lower. With ``is_rough`` the
    rotation is accurate to about 9 degrees.
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
            best = [level.refined(each, _SIMPLEX_SIZES[number]) for each in best]
            found = np.array([level.correlations(each)[0] for each in best])
            distinct = _distinct(Rotation.concatenate(best), found)
            best = distinct[: max(2, _REFINED_ROTATIONS // 4 ** (number + 1))]
            report((number + 2) / (len(_CELLS) + 1))
        best = _identity_preferred(level, best)
    last = [float(level.correlations(each)[0]) for each in best]
    reached = float(level.correlations(best[0], opposite=1.0)[0])
    return SphereRotation(
        best[0], reached, max(last[1:], default=0.0) / last[0] if last[0] > 0 else 1.0
    )


def _identity_preferred(level: _Level, best: list[Rotation]) -> list[Rotation]:
    """Return the rotations, with the identity first if it is nearly as good as the best one.

    Rotations by less than 12 degrees, which differ little from it, are then removed. If the best
    rotation is one of these, nothing changes.
    """
    here = Rotation.identity()
    if best[0].magnitude() < _ROTATION_ANGLE_MIN:
        return best
    if level.correlations(here)[0] < _EQUAL_CORRELATION_SHARE * level.correlations(best[0])[0]:
        return best
    return [here, *(each for each in best if each.magnitude() > _ROTATION_ANGLE_MIN)]


def _scaled(given: SphereFunctions) -> SphereFunctions:
    """Return functions minus their means, with a largest absolute value of 1; constants become 0.

    The squares of large values would overflow.
    """
    scaled = []
    for values in given.functions:
        size = np.abs(values).max()
        unit = values / size if size > 0 else values
        deviations = unit - unit.mean()
        largest = np.abs(deviations).max()
        scaled.append(deviations / largest if largest > _CONSTANT else np.zeros_like(deviations))
    return SphereFunctions(given.layout, np.array(scaled), given.weights)


def rotation_by_landmarks(
    a: SphereLayout, b: SphereLayout, pairs: Landmarks
) -> SphereRotation | None:
    """Return the rotation of sphere A that brings its landmarks closest to those of B.

    The result is None if all landmarks are near one point of a sphere or near two opposite points.
    """
    here, there = a.directions_of(pairs.a), b.directions_of(pairs.b)
    for directions in (here, there):
        if np.linalg.svd(directions, compute_uv=False)[1] < _SPREAD_MIN * np.sqrt(len(pairs)):
            return None
    rotation, _ = Rotation.align_vectors(there, here, pairs.weights)
    return SphereRotation(rotation, np.nan, 0.0)


class _Level:
    """Functions of both spheres as means over ``count`` cells, for one level of the search.

    The functions of sphere A are tables by latitude and longitude. The last table has the weights.
    """

    def __init__(
        self, a: SphereFunctions, b: SphereFunctions, weights: FloatArray, count: int
    ) -> None:
        self._places = spread_directions(count)
        self._target, cell_weights = b.averaged(self._places)
        self._weights = weights
        values, shares = a.averaged(self._places)
        places = KDTree(self._places)
        rows = np.radians(np.linspace(-90, 90, _LATITUDES + 1))
        columns = np.radians(np.linspace(-180, 180, 2 * _LATITUDES + 1))
        latitude, longitude = np.meshgrid(rows, columns, indexing="ij")
        width, height = np.cos(latitude), np.sin(latitude)
        grid = np.stack([width * np.cos(longitude), width * np.sin(longitude), height], axis=-1)
        distances, near = places.query(grid.reshape(-1, 3), 3)
        inverse = 1 / np.maximum(distances, 1e-6)
        inverse /= inverse.sum(axis=1, keepdims=True)
        self._tables = np.einsum(
            "gk,cgk->cg", inverse, np.vstack([values, shares])[:, near]
        ).reshape(-1, *latitude.shape)
        self._cell_weights = cell_weights

    def correlations(self, rotations: Rotation, opposite: float = _SIGN_WEIGHT) -> FloatArray:
        """Return the mean correlation over channels for each of K rotations of sphere A, (K,).

        Negative correlations count by their absolute value times ``opposite``.
        """
        back = np.ascontiguousarray(rotations.inv().as_matrix().reshape(-1, 3, 3))
        interpolated = np.empty((len(self._tables), len(back), len(self._places)))
        _interpolate(back, self._places, self._tables, interpolated)
        counted = self._cell_weights * np.clip(interpolated[-1], 0, None)
        total = np.maximum(counted.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        score = np.zeros(len(back))
        for f, target, weight in zip(interpolated[:-1], self._target, self._weights, strict=True):
            f = f - (counted * f).sum(axis=1, keepdims=True) / total
            g = target - (counted * target).sum(axis=1, keepdims=True) / total
            sizes = (counted * f**2).sum(axis=1) * (counted * g**2).sum(axis=1)
            products = (counted * f * g).sum(axis=1)
            correlation = np.divide(
                products, np.sqrt(sizes), out=np.zeros_like(products), where=sizes > 0
            )
            score += weight * np.maximum(correlation, -opposite * correlation)
        # the score is reduced if both masks have little area in common
        shares = self._tables[-1].mean() * len(self._cell_weights)
        weight_max = float(min(self._cell_weights.sum(), shares))
        overlap = np.minimum(1, 2 * total[:, 0] / weight_max)
        return np.asarray(score / self._weights.sum() * overlap)

    def refined(self, rotation: Rotation, size: float) -> Rotation:
        """Search the best rotation near a given one; the first simplex has ``size`` radians."""
        # imported here, as every registration loads this module and few call this method
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
def _interpolate(
    back: FloatArray, places: FloatArray, tables: FloatArray, interpolated: FloatArray
) -> None:
    """Interpolate functions on a sphere, T tables by latitude and longitude, at rotated points.

    The points are the directions ``places`` (n, 3) after each rotation of ``back`` (K, 3, 3). The
    values are written to ``interpolated`` (T, K, n).
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
                interpolated[t, k, n] = (1 - up) * below + up * above


def _spread_rotations(count: int) -> Rotation:
    """Return evenly spread rotations by super-Fibonacci spirals [Alexa, CVPR 2022]."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    parts = inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)
    return Rotation.from_quat(np.stack(parts, axis=1))


def _distinct(rotations: Rotation, scores: FloatArray) -> list[Rotation]:
    """Return at most 12 rotations by descending score, without near duplicates of better ones."""
    distinct: list[Rotation] = []
    for number in np.argsort(-scores, kind="stable")[: 60 * _REFINED_ROTATIONS]:
        one = rotations[int(number)]
        if all((one * other.inv()).magnitude() > _ROTATION_ANGLE_MIN for other in distinct):
            distinct.append(one)
        if len(distinct) == _REFINED_ROTATIONS:
            break
    return distinct

"""Peaks and pits: known functions, a slow count of the same, and what a change of the function
may do to them.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.matching.solvability import Extrema, peaks, peaks_apart, persistence
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from tests.core.fields import bump
from tests.core.surfaces import SURFACES
from tests.shapes import icosphere, square

SPHERE = icosphere(3)
BALL = icosphere(4)
SEEDS = st.integers(0, 10**6)


def gaussians(count: int) -> FloatArray:
    places = np.array([[0, 0, 1.0], [0, 1, 0], [1, 0, 0]])[:count]
    return np.max([bump(SPHERE, place, 0.1) for place in places], axis=0)


def slow_persistence(mesh: TriangleMesh, f: FloatArray) -> list[float]:
    """For every vertex flood what lies above each lower value, until something higher than the
    vertex is met.
    """
    neighbours: list[set[int]] = [set() for _ in f]
    for a, b in mesh.edges.tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    order = {v: k for k, v in enumerate(sorted(range(len(f)), key=lambda v: (-f[v], v)))}
    found = []
    for peak in range(len(f)):
        death = f.min()
        for level in sorted((v for v in order if order[v] >= order[peak]), key=order.__getitem__):
            reached, front = {peak}, [peak]
            while front:
                new = {w for w in neighbours[front.pop()] if order[w] <= order[level]} - reached
                reached |= new
                front += new
            if any(order[v] < order[peak] for v in reached):
                death = f[level]
                break
        found.append(f[peak] - death)
    return sorted((value for value in found if value > 0), reverse=True)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_gaussians_are_counted(count):
    assert peaks(SPHERE, gaussians(count)) == (count, 1)


@given(SEEDS, st.integers(1, 3))
def test_noise_below_the_bound_adds_none(seed, count):
    noise = np.random.default_rng(seed).uniform(-0.04, 0.04, len(SPHERE.vertices))
    assert peaks(SPHERE, gaussians(count) + noise) == (count, 1)
    assert len(persistence(SPHERE, gaussians(count) + noise)) > 3


def test_a_constant_has_no_peaks():
    for value in (0.0, 0.1, -7.0):
        assert peaks(SPHERE, np.full(len(SPHERE.vertices), value)) == (0, 0)
    assert peaks(SPHERE, 0.1 + 1e-17 * SPHERE.vertices[:, 0]) == (0, 0)


def test_plateaus_are_one_peak_each():
    x, y, _ = SPHERE.vertices.T
    assert_array_equal(persistence(SPHERE, (x > 0.5).astype(float)), [1])
    assert peaks(SPHERE, (np.abs(x) > 0.5).astype(float), 0.0) == (2, 1)
    assert peaks(SPHERE, np.sign(x * y) * (np.abs(x * y) > 0.2)) == (2, 2)


def test_the_edge_of_a_surface_has_peaks():
    mesh = square(12)
    x, y, _ = mesh.vertices.T
    assert peaks(mesh, x) == (1, 1)
    assert peaks(mesh, (2 * x - 1) * (2 * y - 1)) == (2, 2)
    assert peaks(mesh, (x - 0.5) ** 2 + (y - 0.5) ** 2) == (4, 1)


def test_persistence_is_the_depth_of_the_pass():
    """Of two equal Gaussians one lasts to the lowest value, the other to the saddle halfway."""
    width, apart = 0.15, 1.5  # in sqrt(area), in radians

    def height(angle: float) -> float:
        return float(np.exp(-((2 * np.sin(angle / 2)) ** 2) / (2 * width**2 * 4 * np.pi)))

    f = sum(bump(BALL, [0, np.sin(angle), np.cos(angle)], width) for angle in (0.0, apart))
    top, saddle = 1 + height(apart), 2 * height(apart / 2)
    found = persistence(BALL, f)
    assert_allclose(found[:2], [top, top - saddle], atol=0.01)
    assert len(found) == 2


@pytest.mark.parametrize(
    "name", [name for name, mesh in SURFACES.items() if len(mesh.vertices) < 130]
)
def test_the_slow_count_agrees(name):
    mesh = SURFACES[name]
    rng = np.random.default_rng(len(mesh.vertices))
    for f in (
        rng.normal(size=len(mesh.vertices)),
        rng.integers(0, 4, len(mesh.vertices)).astype(float),
    ):
        assert_allclose(persistence(mesh, f), slow_persistence(mesh, f), rtol=0, atol=1e-15)


@given(SEEDS, st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_numbering_scale_and_offset_do_not_matter(seed, factor, offset):
    rng = np.random.default_rng(seed)
    f = np.sin(3 * SPHERE.vertices @ rng.normal(size=(3, 2))).sum(axis=1) + rng.normal(
        0, 0.1, len(SPHERE.vertices)
    )
    new = rng.permutation(len(f))
    values = np.empty_like(f)
    values[new] = f
    vertices = np.empty_like(SPHERE.vertices)
    vertices[new] = SPHERE.vertices
    other = TriangleMesh(vertices, new[SPHERE.faces])
    assert_array_equal(persistence(other, values), persistence(SPHERE, f))
    assert_allclose(
        persistence(SPHERE, factor * f + offset),
        factor * persistence(SPHERE, f),
        rtol=0,
        atol=1e-12 * (1e3 + factor),
    )
    assert peaks(SPHERE, -f) == peaks(SPHERE, f)[::-1]


@given(SEEDS, st.floats(0, 0.5), st.floats(0, 1))
def test_a_small_change_pairs_peaks_up(seed, change, least):
    """The theorem of stability: what stands out by ``least + 2 change`` before stands out by
    ``least`` afterwards.
    """
    rng = np.random.default_rng(seed)
    f = rng.normal(size=len(SPHERE.vertices))
    g = f + rng.uniform(-change, change, len(f))
    assert (persistence(SPHERE, f) >= least + 2 * change).sum() <= (
        persistence(SPHERE, g) >= least - 1e-12
    ).sum()


@given(SEEDS)
def test_functions_that_are_near_are_never_told_different(seed):
    rng = np.random.default_rng(seed)
    f = np.sin(6 * SPHERE.vertices @ rng.normal(size=(3, 2))).sum(axis=1)
    g = f + rng.uniform(-0.09, 0.09, len(f)) * np.ptp(f)
    assert peaks_apart(SPHERE, f, g) is None


def test_functions_with_other_peaks_are_told():
    found = peaks_apart(SPHERE, gaussians(1), gaussians(3))
    assert found == (Extrema(1, 1), Extrema(3, 1))
    assert str(found[1]) == "3 peaks and 1 pit"
    assert peaks_apart(SPHERE, -gaussians(3), -gaussians(1)) == (Extrema(1, 3), Extrema(1, 1))
    assert peaks_apart(SPHERE, gaussians(2), -3 * gaussians(2)) == (Extrema(2, 1), Extrema(1, 2))
    assert peaks_apart(SPHERE, gaussians(2), gaussians(2)) is None

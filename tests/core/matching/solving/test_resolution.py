"""How wide functions are in edges: calibrated on Gaussians, blind to units, local."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.matching.solvability import resolution
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import interpolated, subdivided
from abfm.types import FloatArray
from tests.core.fields import bump
from tests.shapes import disc, icosphere, square, torus


def edge_of(mesh: TriangleMesh) -> float:
    """Edge length of as many equal equilateral triangles as the mesh has, in units of
    length_scale.
    """
    return float(np.sqrt(4 / np.sqrt(3) / len(mesh.faces)))


def gaussian(mesh: TriangleMesh, vertex: int, edges: float) -> FloatArray:
    """Gaussian so many even edges wide."""
    return bump(mesh, mesh.vertices[vertex], edges * edge_of(mesh))


@pytest.mark.parametrize("width", [1.0, 1.5, 2.0, 3.0, 5.0, 8.0])
def test_a_gaussian_is_as_wide_as_it_is(width: float) -> None:
    for mesh, vertex in (
        (icosphere(5), 0),
        (icosphere(5), 5000),
        (square(48), 1250),
        (disc(30), 400),
    ):
        assert_allclose(resolution(mesh, gaussian(mesh, vertex, width)), width, rtol=0.15)


def test_constants_scales_and_units_do_not_matter() -> None:
    mesh = torus(60, 40)
    f = gaussian(mesh, 100, 4)
    found = resolution(mesh, f)
    assert_allclose(resolution(mesh, 1000 - 3 * f), found, rtol=1e-9)
    assert_allclose(resolution(TriangleMesh(1e-5 * mesh.vertices, mesh.faces), f), found, rtol=1e-9)


def test_twice_as_many_edges_on_the_subdivided_mesh() -> None:
    mesh = icosphere(4)
    f = gaussian(mesh, 100, 4)
    assert_allclose(
        resolution(subdivided(mesh), interpolated(mesh, f)), 2 * resolution(mesh, f), rtol=0.1
    )


def test_the_narrower_of_two_bumps_counts() -> None:
    mesh = icosphere(5)
    narrow, wide = gaussian(mesh, 0, 2), gaussian(mesh, int(mesh.vertices[:, 2].argmin()), 12)
    assert resolution(mesh, wide) > 10
    assert 2 < resolution(mesh, narrow + wide) < 3
    assert resolution(mesh, np.stack([wide, narrow], axis=1)) == resolution(mesh, narrow)


def test_edges_count_where_the_function_varies() -> None:
    """Inside a fine patch of a mesh that is coarse elsewhere."""
    even = square(40)
    uneven = TriangleMesh(even.vertices**2 * [1, 1, 0], even.faces)  # fine towards one corner
    fine, coarse = ([0.1, 0.1, 0], [0.8, 0.8, 0])
    assert resolution(uneven, bump(uneven, fine, 0.05)) > 2 * resolution(
        uneven, bump(uneven, coarse, 0.05)
    )


def test_a_jump_spans_half_an_edge_and_a_constant_any_number() -> None:
    mesh = icosphere(4)
    assert resolution(mesh, (mesh.vertices[:, 2] > 0.1).astype(float)) == 0.5
    assert resolution(mesh, np.full(len(mesh.vertices), 3.3)) == np.inf
    assert (
        resolution(mesh, 3.3 + 1e-12 * np.random.default_rng(0).normal(size=len(mesh.vertices)))
        == np.inf
    )
    assert resolution(mesh, np.zeros(len(mesh.vertices))) == np.inf

"""What must not change a function: motion, scale (up to its unit), vertex numbers, and being computed again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm.functions import function
from abfm.mesh import TriangleMesh
from tests.shapes import icosphere

POWER_OF_LENGTH = {
    "gaussian:vertex=12,width=0.1": 0,
    "gaussian:vertex=12,metric=euclidean": 0,
    "eigenfunction:7": 0,
    "eigenfunction:40": 0,
    "hks": 0,
    "wks": 0,
    "curvature:gaussian": -2,
    "curvature:mean": -1,
    "geodesic:vertex=12,99": 1,
    "shape-diameter": 1,
    "indicator:vertex=12,radius=0.2": 0,
}


def potato() -> TriangleMesh:
    """A closed surface without any symmetry."""
    sphere = icosphere(3)
    x, y, z = sphere.vertices.T
    radius = 1 + 0.3 * np.sin(2 * x + 0.4) * np.cos(3 * y - 1) + 0.2 * z * x + 0.15 * y
    return TriangleMesh(sphere.vertices * radius[:, None] * [1, 1.3, 0.8], sphere.faces)


POTATO = potato()


@pytest.mark.parametrize("spec", POWER_OF_LENGTH)
def test_motion_and_scale(spec: str) -> None:
    scale = 40.0
    turned = scale * POTATO.vertices @ Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix().T + [5, -80, 13]
    expected = function(POTATO, spec) * scale ** POWER_OF_LENGTH[spec]
    f = function(TriangleMesh(turned, POTATO.faces), spec)
    assert_allclose(f, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("spec", POWER_OF_LENGTH)
def test_vertex_numbers(spec: str) -> None:
    rng = np.random.default_rng(2)
    number = rng.permutation(len(POTATO.vertices))  # new number of every vertex
    vertices = np.empty_like(POTATO.vertices)
    vertices[number] = POTATO.vertices
    faces = np.roll(rng.permutation(number[POTATO.faces]), 1, axis=1)
    renamed = spec.replace("12", str(number[12])).replace("99", str(number[99]))
    expected = function(POTATO, spec)
    f = function(TriangleMesh(vertices, faces), renamed)[number]
    assert_allclose(f, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("spec", POWER_OF_LENGTH)
def test_the_same_mesh_gives_the_same_bits(spec: str) -> None:
    assert_array_equal(function(potato(), spec), function(potato(), spec))
    assert_array_equal(function(POTATO, spec), function(POTATO, spec))


def test_the_same_sphere_gives_the_same_function_of_a_degenerate_eigenspace() -> None:
    assert_array_equal(function(icosphere(4), "eigenfunction:5"), function(icosphere(4), "eigenfunction:5"))

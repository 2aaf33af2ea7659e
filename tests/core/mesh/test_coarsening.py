"""Coarser meshes: of the same topology and side, near the surface, even, and none where there
can be none.
"""

from __future__ import annotations

import numpy as np
import pytest

import abfm
from abfm.assets import asset_path
from abfm.calculus.operators import face_areas, face_normals
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from tests.core.surfaces import SURFACES
from tests.core.verification import observed_orders
from tests.shapes import disc, hemisphere, icosphere, open_cylinder, square, torus

FINE = {
    "sphere": icosphere(4),
    "torus": torus(60, 30),
    "genus two": SURFACES["genus two"],
    "body": abfm.load_mesh(asset_path("human_A.off")),
    "square": square(30),
    "hemisphere": hemisphere(20),
    "cylinder": open_cylinder(40, 20),
}


@pytest.fixture(params=FINE)
def fine(request: pytest.FixtureRequest) -> TriangleMesh:
    return FINE[request.param]


@pytest.mark.parametrize("share", [0.6, 0.25, 0.12])
def test_topology_stays_and_the_count_is_near_what_was_asked(
    fine: TriangleMesh, share: float
) -> None:
    asked = int(share * len(fine.vertices))
    coarse = coarsened(fine, asked)
    assert coarse is not None
    assert asked * 0.95 <= len(coarse.vertices) <= 1.2 * asked
    assert coarse.euler_characteristic == fine.euler_characteristic
    assert coarse.boundary_loop_count == fine.boundary_loop_count
    assert coarse.genus == fine.genus
    assert coarse.messages == ()


def test_it_lies_near_the_surface_and_looks_to_the_same_side(fine: TriangleMesh) -> None:
    coarse = coarsened(fine, len(fine.vertices) // 4)
    assert coarse is not None
    edge = fine.length_scale / np.sqrt(len(coarse.faces))
    middles = coarse.vertices[coarse.faces].mean(axis=1)
    near = project_onto_surface(fine, middles)
    assert near.distances_from(middles).max() < edge
    cosines = (face_normals(coarse) * face_normals(fine)[near.faces]).sum(axis=1)
    assert np.average(cosines, weights=face_areas(coarse)) > 0.85
    back = project_onto_surface(coarse, fine.vertices)
    assert (
        back.distances_from(fine.vertices).max() < 3 * edge
    )  # ends of limbs, and corners, are cut


@pytest.mark.parametrize("make", [icosphere, lambda k: torus(15 * 2 ** (k - 2), 7 * 2 ** (k - 2))])
def test_area_converges_with_the_count(make) -> None:
    """A quarter of the vertices of ever finer meshes: what is missing falls like the square of
    the edge length.
    """
    missing = []
    for k in (3, 4, 5):
        fine = make(k)
        coarse = coarsened(fine, len(fine.vertices) // 4)
        assert coarse is not None
        missing.append(1 - face_areas(coarse).sum() / face_areas(fine).sum())
    assert observed_orders([4, 2, 1], missing).min() > 1.6
    assert missing[-1] < 0.005


def test_needles_are_the_first_to_go() -> None:
    """A cylinder with two rings of vertices a hundredth of an edge apart, where the cost is set
    by the least height.
    """
    even = open_cylinder(40, 20)
    height = even.vertices[:, 2]
    ring = np.isclose(height, np.unique(height.round(9))[10])
    fine = TriangleMesh(even.vertices - np.outer(ring, [0, 0, 0.099]), even.faces)
    coarse = coarsened(fine, int(0.7 * len(fine.vertices)))
    assert coarse is not None

    def median_over_least_height(mesh: TriangleMesh) -> float:
        corners = mesh.vertices[mesh.faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        heights = 2 * face_areas(mesh) / longest
        return float(np.median(heights) / heights.min())

    assert median_over_least_height(coarse) < 0.1 * median_over_least_height(fine)


def test_same_input_same_bits_in_any_power_of_two_as_unit() -> None:
    mesh = FINE["body"]
    one = coarsened(TriangleMesh(mesh.vertices, mesh.faces), 300)
    other = coarsened(TriangleMesh(mesh.vertices, mesh.faces), 300)
    large = coarsened(TriangleMesh(2.0**20 * mesh.vertices, mesh.faces), 300)
    small = coarsened(TriangleMesh(2.0**-20 * mesh.vertices, mesh.faces), 300)
    assert one is not None
    assert other is not None
    assert large is not None
    assert small is not None
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.vertices, large.vertices / 2.0**20)
    np.testing.assert_array_equal(one.vertices, small.vertices * 2.0**20)
    for each in (other, large, small):
        np.testing.assert_array_equal(one.faces, each.faces)


def test_it_is_made_once() -> None:
    mesh = torus(40, 20)
    assert coarsened(mesh, 200) is coarsened(mesh, 200)
    assert coarsened(mesh, 100) is not coarsened(mesh, 200)
    assert coarsened(SURFACES["tetrahedron"], 4) is None


@pytest.mark.parametrize("name", ["tetrahedron", "triangle", "no inner vertices"])
def test_what_is_as_small_as_its_topology_allows_has_no_coarser_mesh(name: str) -> None:
    assert coarsened(SURFACES[name], 4) is None


@pytest.mark.parametrize(
    ("mesh", "count"),
    [
        (SURFACES["genus two"], 9),
        (open_cylinder(30, 1), 4),
        (disc(8), 4),
        (icosphere(2), 3),
        (icosphere(2), 1),
        (icosphere(2), 162),
        (icosphere(2), 1000),
    ],
)
def test_what_cannot_shrink_so_far_or_at_all_has_none(mesh: TriangleMesh, count: int) -> None:
    assert coarsened(mesh, count) is None

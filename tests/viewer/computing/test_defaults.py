"""The functions that a mesh is opened with."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import TriangleMesh, load_mesh, match
from abfm.assets import asset_names, asset_path
from abfm.calculus import vertex_areas
from abfm.calculus.geodesics import geodesic_distance
from abfm.functions import function, parse, vertex_normals
from abfm.matching import resolution
from abfm_viewer.computing.defaults import WIDTH, best_front, default_functions
from abfm_viewer.document.gaussians import landmark
from tests.shapes import disc, ellipsoid, square, torus

MESHES = [name for name in asset_names() if name.endswith(".off")]
HUMANS = [name for name in MESHES if name.startswith("human")]
RNG = np.random.default_rng(0)


def centres(mesh: TriangleMesh) -> tuple[int, int]:
    """The vertices of the two Gaussians."""
    source, target = (int(np.argmax(function(mesh, spec))) for spec in default_functions(mesh))
    return source, target


@pytest.mark.parametrize(
    "mesh", [*MESHES, torus(30, 20), disc(8), ellipsoid(3, 3.0, 1.0, 1.0)], ids=str
)
def test_any_mesh_gets_two_gaussians_well_apart_on_one_side_of_it(mesh):
    mesh = load_mesh(asset_path(mesh)) if isinstance(mesh, str) else mesh
    source, target = centres(mesh)
    end = int(np.argmax(geodesic_distance(mesh, [0])))
    longest = geodesic_distance(mesh, [end]).max()
    apart = geodesic_distance(mesh, [source])[target]
    assert 0.2 < apart / longest < 0.45
    assert apart < 0.8 * mesh.length_scale
    normals = vertex_normals(mesh)
    assert normals[source] @ normals[target] > 0


@pytest.mark.parametrize("name", HUMANS)
def test_on_a_body_they_are_at_a_knee_and_at_the_breast_and_not_at_the_fork_of_the_legs(name):
    mesh = load_mesh(asset_path(name))
    heights = mesh.vertices[:, 1]
    source, target = (
        (heights[centre] - heights.min()) / np.ptp(heights) for centre in centres(mesh)
    )
    low, high = sorted((source, target))
    fork = 0.47  # of the height
    assert 0.2 < low < fork - 0.05
    assert fork + 0.13 < high < 0.85


@pytest.mark.parametrize("mesh", [*MESHES, torus(30, 20), ellipsoid(3, 3.0, 1.0, 1.0)], ids=str)
def test_they_face_who_looks_from_the_meshs_front(mesh):
    mesh = load_mesh(asset_path(mesh)) if isinstance(mesh, str) else mesh
    facing = vertex_normals(mesh) @ best_front(mesh).direction
    assert min(facing[list(centres(mesh))]) > 0.4
    for spec in default_functions(mesh):
        covered = vertex_areas(mesh) * function(mesh, spec)
        # a quarter is what is seen of a ball
        assert covered @ np.maximum(facing, 0) > 0.25 * covered.sum()


def test_numbers_and_scale_do_not_matter():
    mesh = load_mesh(asset_path("human_A.off"))
    order = RNG.permutation(len(mesh.vertices))
    place = np.argsort(order)
    other = TriangleMesh(
        1e3 * mesh.vertices[order], place[mesh.faces][RNG.permutation(len(mesh.faces))]
    )
    np.testing.assert_array_equal(order[list(centres(other))], centres(mesh))


def test_a_coarse_mesh_gets_wider_ones():
    widths = [parse(default_functions(ellipsoid(k, 3.0, 1.0, 1.0))[0]).width for k in (1, 3, 5)]
    assert widths == sorted(widths, reverse=True)
    assert widths[0] > widths[-1] == WIDTH


def test_they_are_no_wider_than_an_even_mesh_needs():
    mesh = square(20)
    for spec in default_functions(mesh):
        assert parse(spec).width > WIDTH
        assert 3.5 < resolution(mesh, function(mesh, spec)) < 4.6


def test_where_they_would_span_hardly_an_edge_they_are_farther_apart_and_wider():
    coarse, fine = (ellipsoid(subdivisions, 3.0, 1.0, 1.0) for subdivisions in (1, 4))
    shares = []
    for mesh in (coarse, fine):
        source, target = centres(mesh)
        from_source = geodesic_distance(mesh, [source])
        shares.append(from_source[target] / from_source.max())
    assert shares[0] > 1.15 * shares[1]
    assert (
        parse(default_functions(coarse)[0]).width > 1.15 * parse(default_functions(fine)[0]).width
    )


def test_a_surface_that_is_inside_out_gets_the_same():
    mesh = load_mesh(asset_path("human_A.off"))
    assert default_functions(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])) == default_functions(
        mesh
    )


@pytest.mark.parametrize("name", [name for name in MESHES if "fine" not in name])
def test_they_are_matched_or_nearly_so(name):
    mesh = load_mesh(asset_path(name))
    source, target = (function(mesh, spec) for spec in default_functions(mesh))
    assert match(mesh, source, target).verdict.kind in ("matched", "nearly")
    assert vertex_areas(mesh) @ np.minimum(source, target) < 0.7 * vertex_areas(mesh) @ source


@pytest.mark.parametrize("name", ["human_A.off", "eight.off"])
def test_with_a_second_channel_as_it_is_added_they_still_are(name):
    mesh = load_mesh(asset_path(name))
    pair = default_functions(mesh)
    stays = landmark(pair, mesh)
    source, target = (
        np.stack([function(mesh, spec), function(mesh, stays)], axis=1) for spec in pair
    )
    assert match(mesh, source, target).verdict.kind in ("matched", "nearly")


def test_vertices_are_counted_as_the_file_does():
    whole = torus(12, 8)
    gap = TriangleMesh(np.vstack([np.zeros((5, 3)), whole.vertices]), whole.faces + 5)
    for spec, shifted in zip(default_functions(whole), default_functions(gap), strict=True):
        assert parse(shifted).vertex[0] == parse(spec).vertex[0] + 5

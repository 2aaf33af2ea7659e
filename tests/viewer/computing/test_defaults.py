from functools import cache

import numpy as np
import pytest

from abfm import Parameters, Problem, TriangleMesh, load_mesh, match
from abfm.assets import asset_names, asset_path
from abfm.calculus import geodesic_distance, vertex_areas
from abfm.functions import function, parse, vertex_normals
from abfm.matching import resolution
from abfm.outcome import Outcome
from abfm.pages.front import changes_in_time, front_of
from abfm_viewer.computing.defaults import WIDTH, default_functions
from abfm_viewer.document.gaussians import landmark
from tests.shapes import disc, ellipsoid, icosphere, square, torus

MESHES = [name for name in asset_names() if name.endswith(".off")]
COARSE = [name for name in MESHES if "fine" not in name and name != "human_B.off"]
"""The bundled meshes, with one pose of the body."""
RNG = np.random.default_rng(0)

ellipsoid = cache(ellipsoid)
specs = cache(default_functions)


@cache
def mesh_of(mesh):
    return load_mesh(asset_path(mesh)) if isinstance(mesh, str) else mesh


def centres(mesh):
    return [int(np.argmax(function(mesh, spec))) for spec in specs(mesh)]


def width(mesh):
    return parse(specs(mesh)[0]).width


@pytest.mark.parametrize(
    "mesh", [*MESHES, torus(30, 20), disc(8), ellipsoid(3, 3.0, 1.0, 1.0)], ids=str
)
def test_default_gaussians_face_the_viewer(mesh):
    mesh = mesh_of(mesh)
    source, target = centres(mesh)
    distance = geodesic_distance(mesh, [source])[target] / mesh.length_scale
    assert 0.3 < distance / width(mesh) < 0.8
    normals = vertex_normals(mesh)
    assert normals[source] @ normals[target] > 0
    facing = normals @ front_of(mesh).direction
    assert min(facing[[source, target]]) > 0.25
    for spec in specs(mesh):
        covered = vertex_areas(mesh) * function(mesh, spec)
        # 0.25 is the mean for a ball
        assert covered @ np.maximum(facing, 0) > 0.25 * covered.sum()


@pytest.mark.parametrize("name", [name for name in MESHES if name.startswith("human")])
def test_gaussians_of_a_body_are_on_the_trunk(name):
    heights = mesh_of(name).vertices[:, 1]
    found = (heights[centres(mesh_of(name))] - heights.min()) / np.ptp(heights)
    assert found.min() > 0.45
    assert found.max() < 0.85


def test_defaults_do_not_depend_on_numbers_and_scale():
    mesh = mesh_of("human_A.off")
    order, faces = RNG.permutation(len(mesh.vertices)), RNG.permutation(len(mesh.faces))
    other = TriangleMesh(1e3 * mesh.vertices[order], np.argsort(order)[mesh.faces][faces])
    np.testing.assert_array_equal(order[centres(other)], centres(mesh))
    assert specs(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])) == specs(mesh)
    closed = torus(12, 8)
    gap = TriangleMesh(np.vstack([np.zeros((5, 3)), closed.vertices]), closed.faces + 5)
    for spec, shifted in zip(specs(closed), specs(gap), strict=True):
        assert parse(shifted).vertex[0] == parse(spec).vertex[0] + 5


def test_coarse_mesh_has_wider_gaussians():
    widths = [width(ellipsoid(k, 3.0, 1.0, 1.0)) for k in (1, 3, 5)]
    assert widths == sorted(widths, reverse=True)
    assert widths[0] > widths[-1] == WIDTH
    mesh = square(20)
    assert width(mesh) > WIDTH
    for spec in specs(mesh):
        assert 2.5 < resolution(mesh, function(mesh, spec)) < 4.6


@pytest.mark.parametrize("name", COARSE)
def test_default_functions_match_well(name):
    mesh = mesh_of(name)
    facts = match(Problem(mesh, *([spec] for spec in specs(mesh)))).facts
    assert facts.outcome is Outcome.MATCHED
    assert facts.tone == "good"
    assert facts.numbers["worse_residual"] <= 0.05
    assert facts.numbers["log2_area_95"] <= 1
    assert facts.numbers["initial_residual"] > 0.3  # the motion is visible


@pytest.mark.parametrize(
    ("name", "refine", "residual_max"), [("human_A.off", 0, 0.15), ("eight.off", 1, 0.15)]
)
def test_added_channel_is_nearly_matched(name, refine, residual_max):
    mesh = mesh_of(name)
    stays = function(mesh, landmark(specs(mesh), mesh))
    f, g = (np.stack([function(mesh, spec), stays], axis=1) for spec in specs(mesh))
    assert match(mesh, f, g, Parameters(refine=refine)).worse_residual < residual_max


def test_front_of_a_sequence_shows_its_changes():
    """The front shows the largest changes in time, not large values or a constant part."""
    mesh = icosphere(3)
    x, _, z = mesh.vertices.T
    times = np.arange(4.0)[:, None]
    large_in_front = 5.0 * (z > 0.5) + np.sin(times) * np.maximum(-x, 0) ** 4
    assert front_of(mesh, changes=changes_in_time(large_in_front[..., None])).direction[0] < -0.7
    all_but_the_front = np.sin(times) * (z < 0.3)
    assert front_of(mesh, changes=changes_in_time(all_but_the_front[..., None])).direction[2] < 0
    still = np.broadcast_to(z, (4, len(z)))[..., None]
    assert front_of(mesh, changes=changes_in_time(still)) == front_of(mesh)
    both = np.stack([large_in_front, np.full_like(large_in_front, np.nan)], axis=2)
    np.testing.assert_array_equal(changes_in_time(both), changes_in_time(large_in_front[..., None]))

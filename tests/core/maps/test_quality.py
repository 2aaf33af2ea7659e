"""Distances from the surface and folds of maps made to have them, and their warnings."""

import numpy as np
import pytest

from abfm.assets import asset_path
from abfm.errors import AbfmError
from abfm.experiments.fields import feet, stream_field
from abfm.flow.flow import Flow
from abfm.maps.distortion import distortion
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import FOLDED, LARGEST_DISTANCE, RMS_DISTANCE, MapQuality, map_quality
from abfm.mesh import TriangleMesh, load_mesh
from tests.shapes import icosphere, square, torus


def test_the_identity_and_an_isometry_are_perfect():
    mesh = torus(24, 12)
    turned = TriangleMesh(7 * mesh.vertices[:, [1, 2, 0]], mesh.faces)
    for codomain in (mesh, turned):
        found = map_quality(PointMap.of_vertices(mesh, codomain))
        assert found == MapQuality(0.0, 0.0, 0.0)
        assert found.warning is None


@pytest.mark.parametrize("unit", [1e-3, 1.0, 50.0])
def test_distances_are_those_that_were_given_in_any_unit(unit):
    mesh = square(8)
    mesh = TriangleMesh(2 * unit * mesh.vertices, mesh.faces)
    off = np.linspace(0, 0.3, len(mesh.vertices))
    moved = mesh.vertices + 2 * unit * np.outer(off, [0, 0, 1])
    found = map_quality(PointMap.project(mesh, mesh, moved))
    assert found.largest_distance == pytest.approx(0.3)
    assert found.rms_distance == pytest.approx(np.sqrt(np.mean(off**2)))
    assert found.folded == 0
    assert found.warning is not None
    assert "up to 0.3 sqrt(area) off the surface" in found.warning
    assert "folded" not in found.warning


def test_a_mirror_folds_everything_and_a_dragged_vertex_its_own_faces():
    mesh = torus(24, 12)
    mirrored = map_quality(PointMap.project(mesh, mesh, mesh.vertices * [1, 1, -1]))
    assert mirrored.folded == 1
    assert mirrored.largest_distance < 1e-12
    assert mirrored.warning is not None
    assert "100% of the faces folded" in mirrored.warning
    flat = square(6)
    dragged = flat.vertices.copy()
    dragged[np.argmin(np.linalg.norm(flat.vertices - [0.5, 0.5, 0], axis=1))] += [0.3, 0, 0]
    few = map_quality(PointMap.project(flat, flat, dragged))
    assert few.folded == distortion(flat, dragged).flipped.sum() / len(flat.faces)
    assert 0 < few.folded < FOLDED
    assert few.warning is None


def test_folds_are_judged_on_the_surface_that_the_map_leads_to():
    """A half-turned copy: on the mesh itself half of the normals would look the other way."""
    mesh = icosphere(2)
    turned = TriangleMesh(mesh.vertices * [-1, -1, 1], mesh.faces)
    assert map_quality(PointMap.of_vertices(mesh, turned)).folded == 0
    inside_out = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    assert distortion(mesh, mesh.vertices, inside_out).flipped.all()


def test_every_bound_warns_alone():
    for over in (
        MapQuality(1.01 * LARGEST_DISTANCE, 0.0, 0.0),
        MapQuality(0.0, 1.01 * RMS_DISTANCE, 0.0),
        MapQuality(0.0, 0.0, 1.01 * FOLDED),
    ):
        assert over.warning is not None
        assert "\n" not in over.warning
    assert MapQuality(LARGEST_DISTANCE, RMS_DISTANCE, FOLDED).warning is None


def test_the_report_has_the_numbers():
    assert MapQuality(0.25, 0.0125, 0.031).report() == (
        "off the surface: largest 0.25, RMS 0.0125 sqrt(area); folded: 3.1 % of the faces"
    )


SURFACES = {
    "eight": load_mesh(asset_path("eight.off")),
    "torus": torus(40, 20),
    "sphere": icosphere(3),
}


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("modes", [{1: 1.0, 2: 1.0}, {5: 1.0, 8: 1.0}])
@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6])
def test_maps_without_a_warning_are_near_exact_flow_lines(name, modes, speed):
    mesh = SURFACES[name]
    field = stream_field(mesh, modes, speed)
    points = Flow(mesh, field).point_map()
    found = map_quality(points)
    errors = (
        np.linalg.norm(points.positions - feet(mesh, field, np.ones(1))[0], axis=1)
        / mesh.length_scale
    )
    if found.warning is None:
        assert errors.mean() < 0.025
    if found.largest_distance > LARGEST_DISTANCE:
        assert errors.max() > 0.15
    if found.rms_distance > RMS_DISTANCE:
        assert errors.mean() > 0.028


def test_a_map_of_other_vertices_is_refused():
    mesh = icosphere(1)
    with pytest.raises(AbfmError, match="one point per vertex"):
        PointMap.of_vertices(mesh, mesh, np.arange(5))

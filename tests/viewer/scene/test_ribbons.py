"""Ribbons of lines and isolines, which lie on the surface and show the direction of the flow."""

import numpy as np
import pytest

from abfm import TriangleMesh
from abfm.calculus import face_areas
from abfm.flow import flow_lines
from abfm.maps import SurfacePoints
from abfm_viewer.scene import overlays
from tests.shapes import icosphere, square

SPHERE = icosphere(4)
UNIT = SPHERE.length_scale
HALF = 0.004


def around(duration=1.0):
    """Return a flow line of a rotation about the z axis."""
    centres = SPHERE.vertices[SPHERE.faces].mean(axis=1)
    face = np.argmin(np.abs(centres - [1, 0, 0]).sum(axis=1), keepdims=True)
    start = SurfacePoints(SPHERE, face, np.full((1, 3), 1 / 3))
    return flow_lines(SPHERE, np.cross([0, 0, 1.0], centres), start, duration)[0]


def angles(places):
    return np.unwrap(np.arctan2(places[:, 1], places[:, 0]))


@pytest.mark.parametrize("duration", [1.0, -1.0])
def test_path_has_the_direction_of_the_flow(duration):
    path = overlays.path_of_line(SPHERE, around(duration))
    assert angles(path.places)[-1] > angles(path.places)[0]
    np.testing.assert_allclose(np.linalg.norm(path.normals, axis=1), 1)
    np.testing.assert_allclose(path.normals, UNIT * path.places, atol=0.05)
    through = overlays.path_through(SPHERE, UNIT * path.places)
    np.testing.assert_allclose(through.normals, path.normals, atol=1e-6)
    np.testing.assert_allclose(through.lengths, path.lengths)


def test_no_lines_have_no_ribbons():
    assert [part.shape for part in overlays.line_ribbons([], HALF)] == [(0, 3), (0, 3)]


def test_line_has_heads():
    path = overlays.path_of_line(SPHERE, around(3.0))
    vertices, faces = overlays.line_ribbons([path], HALF)
    assert faces.max() == len(vertices) - 1
    height = np.interp(angles(vertices), angles(path.places), path.places[:, 2])
    off = np.abs(vertices[:, 2] - height)
    wide = np.sort(angles(vertices[off > 1.5 * HALF]))
    heads = 1 + (np.diff(wide) > 0.1).sum()
    assert heads == pytest.approx(path.lengths[-1] / 0.16, abs=1)


def test_isolines_have_their_values():
    mesh = square(20)
    x = mesh.vertices[:, 0]
    vertices, faces = overlays.isoline_ribbons(mesh, x, [0.25, 0.6], HALF)
    off = np.abs(mesh.length_scale * vertices[:, :1] - [0.25, 0.6]).min(axis=1)
    assert off.max() < 2 * HALF * mesh.length_scale
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert np.ptp(vertices[:, 1]) * mesh.length_scale >= 1
    mesh = square(6)
    flat = np.where(mesh.vertices[:, 0] > 0.5, 1.0, 0.5)
    _, faces = overlays.isoline_ribbons(mesh, flat, [0.5, 1.0], HALF)
    in_flat_parts = np.ptp(flat[mesh.faces], axis=1) == 0
    assert 0 < len(faces) <= 4 * (~in_flat_parts).sum()
    assert len(overlays.isoline_ribbons(mesh, np.ones(len(flat)), [1.0], HALF)[1]) == 0


def test_lines_are_outside_an_inverted_surface():
    inside_out = TriangleMesh(SPHERE.vertices, SPHERE.faces[:, ::-1])
    path = overlays.path_through(inside_out, SPHERE.vertices[[0, 20, 40]])
    assert (path.normals * path.places).sum(axis=1).min() > 0
    lowest = [
        np.linalg.norm(overlays.isoline_ribbons(mesh, z, [0.0, 0.5], HALF)[0], axis=1).min()
        for mesh, z in ((inside_out, inside_out.vertices[:, 2]), (SPHERE, SPHERE.vertices[:, 2]))
    ]
    assert lowest[0] == pytest.approx(lowest[1])


COARSE = icosphere(3)


def test_evenly_spread_faces_are_large():
    chosen = overlays.evenly_spread(COARSE)
    assert len(np.unique(chosen)) == len(chosen) < len(COARSE.faces) / 2
    assert face_areas(COARSE)[chosen].mean() >= face_areas(COARSE).mean()


def test_ribbons_face_outwards():
    """Ribbons face outwards, so those on the far side are hidden behind edges."""
    centres = COARSE.vertices[COARSE.faces].mean(axis=1)
    starts = SurfacePoints(COARSE, np.arange(0, 1280, 40), np.full((32, 3), 1 / 3))
    lines = flow_lines(COARSE, np.cross([0, 0, 1.0], centres), starts, 0.3)
    paths = [overlays.path_of_line(COARSE, line) for line in lines]
    levels = np.linspace(-0.5, 0.5, 5)
    for vertices, faces in (
        overlays.line_ribbons(paths, 0.005),
        overlays.isoline_ribbons(COARSE, COARSE.vertices[:, 2], levels, 0.005),
    ):
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        outwards = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1)
        assert (outwards > 0).sum() > 0.8 * len(faces)  # tips and corners have no area
        assert (outwards >= -1e-15).all()


def test_line_keeps_its_width_at_sharp_turns():
    corners = np.array([[0, 0], [0.1, 0.01], [0, 0.03], [0, 0.03], [0.12, 0.06], [0.12, 0.2]])
    places = np.column_stack([corners, np.zeros(len(corners))])
    path = overlays.SurfacePath(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))
    vertices, faces = overlays.line_ribbons([path], HALF)
    a, b, c = np.moveaxis(vertices[faces][..., :2], 1, 0)

    def cross(one, other):
        return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]

    assert (cross(b - a, c - a) >= -1e-15).all()
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    around_turns = (corners[1:-1, None] + 0.95 * HALF * circle).reshape(-1, 1, 2)
    sides = [cross(q - p, around_turns - p) for p, q in ((a, b), (b, c), (c, a))]
    assert (np.min(sides, axis=0) >= -1e-12).any(axis=1).all()
    steps = np.linspace(0, 1, 400)[:, None, None]
    line = (corners[:-1] + steps * np.diff(corners, axis=0)).reshape(-1, 2)
    away = np.linalg.norm(vertices[:, None, :2] - line, axis=2).min(axis=1)
    assert np.quantile(away, 0.9) < 1.01 * HALF < away.max() < 3 * HALF  # excluding arrow heads

"""Rings and wedges: what is known of their motion, on a sphere, and what is said of it."""

from itertools import pairwise

import numpy as np
import pytest

from abfm import TriangleMesh
from abfm.io import brain_files
from laboratory import retinotopy
from laboratory.motion import compared, solved
from laboratory.retinotopy import Maps, Stimulus
from tests.shapes import icosphere

BALL = icosphere(3)
X, Y, Z = BALL.vertices.T
CENTRES = BALL.vertices[BALL.faces].mean(axis=1)
# outward is down from the pole
COLATITUDE = np.arccos(np.clip(Z, -1, 1))
MAPS = Maps(
    BALL,
    np.exp(2 * (COLATITUDE - 0.5)),
    np.degrees(np.abs(np.arctan2(Y, X))),
    np.where((COLATITUDE > 0.3) & (COLATITUDE < 2.6), np.where(Y < 0, 1.0, 2.0), 7.0),
)


@pytest.mark.parametrize("kind", ["ring", "wedge"])
def test_the_known_field_is_that_of_the_sphere(kind):
    stimulus = Stimulus(MAPS, kind)
    x, y, z = CENTRES[MAPS.inside].T
    rho = np.hypot(x, y)
    if kind == "ring":  # down a meridian by half a radian for one e-fold
        expected = np.stack([x * z / rho, y * z / rho, -rho], axis=1) / 2
    else:  # eastwards in the east, westwards in the west
        expected = np.stack([-y, x, 0 * z], axis=1) * np.radians(np.where(y > 0, 1, -1))[:, None]
    normal = stimulus.normal[MAPS.inside]
    apart = np.linalg.norm(normal - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert np.median(apart) < 0.03
    speeds = np.linalg.norm(expected, axis=1)
    assert stimulus.pace == pytest.approx(MAPS.edge / np.median(speeds), rel=0.02)


def test_errors_are_those_that_were_made():
    stimulus, step = Stimulus(MAPS, "ring"), 0.2
    known = step * stimulus.normal
    assert stimulus.errors(1.0, step, known) == pytest.approx((0, 0), abs=1e-5)
    assert stimulus.errors(1.0, step, -known) == pytest.approx((180, 2), abs=1e-5)
    across = np.cross(CENTRES, known)
    angle, speed = stimulus.errors(1.0, step, 1.1 * (known + across))
    assert angle == pytest.approx(45, abs=0.5)
    assert speed == pytest.approx(0.1, abs=0.01)


def test_nothing_is_told_beyond_the_areas_and_where_they_meet():
    told = Stimulus(MAPS, "wedge").told(Stimulus(MAPS, "wedge").shown(np.array([60.0]))[0])
    corners = MAPS.area[BALL.faces[told]]
    assert told.any()
    assert np.isin(corners, (1, 2)).all()
    assert (corners == corners[:, :1]).all()
    frames = Stimulus(MAPS, "wedge").measured(np.array([60.0, 70.0]), 0.1)
    assert (np.isfinite(frames) == MAPS.seen).all()
    clean = Stimulus(MAPS, "wedge").shown(np.array([60.0, 70.0]))
    noise = (frames - clean)[:, MAPS.seen]
    assert noise.std() == pytest.approx(0.1 * clean[:, MAPS.seen].std(), rel=0.1)


def test_angles_go_round():
    wedge = Stimulus(MAPS, "wedge")
    np.testing.assert_allclose(*wedge.shown(np.array([-20.0, 340.0])), atol=1e-12)
    steps = [(0, 20), (170, 190), (200, 220), (260, 280), (340, 0)]
    assert [wedge.happens(*map(float, step)) for step in steps] == [
        "moves",
        "comes or goes",
        "comes or goes",
        "is elsewhere",
        "comes or goes",
    ]
    centres = wedge.course(30.0)
    assert len(centres) == 24
    assert centres.max() < 360
    ring = Stimulus(MAPS, "ring")
    happens = [ring.happens(*step) for step in pairwise(ring.course(0.5))]
    assert (happens.count("moves"), happens.count("jumps back")) == (len(happens) - 1, 1)


def test_fields_of_a_ring_are_found():
    ring = Stimulus(MAPS, "ring")
    centres = ring.centres(2.0)[:3]
    step = centres[1] - centres[0]
    found = solved(BALL, ring.measured(centres, 0.0))
    errors = compared(found, lambda i, field: ring.errors(centres[i], step, field))
    assert errors.shape == (3, 2)
    assert (errors[1:] < [[8, 0.1], [8, 0.1]]).all()


def test_a_course_says_where_the_ring_moves_and_where_it_jumps():
    rows = list(retinotopy.course_rows(Stimulus(MAPS, "ring"), 3.0, 0.05))
    moves, jumps = (dict(zip(retinotopy.COURSE_HEADS, row, strict=True)) for row in rows)
    assert (moves["the stimulus"], jumps["the stimulus"]) == ("moves", "jumps back")
    assert moves["confirmed"] == moves["intervals"]
    assert (jumps["intervals"], jumps["confirmed"], jumps["angle"]) == ("1", "0", "")


def test_both_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(retinotopy, "FRAMES", 2)
    retinotopy.drawn(MAPS, BALL, tmp_path / "drawn.png")
    assert (tmp_path / "drawn.png").read_bytes().startswith(b"\x89PNG")


def test_arrows_go_with_their_faces():
    turned = TriangleMesh(BALL.vertices[:, [1, 2, 0]], BALL.faces)
    field = Stimulus(MAPS, "ring").normal
    carried = np.einsum("fxy,fy->fx", retinotopy._carriers(BALL, turned), field)
    np.testing.assert_allclose(carried, field[:, [1, 2, 0]], atol=1e-9)
    chosen = retinotopy._apart(CENTRES, np.arange(len(CENTRES)), 0.5)
    spaces = np.linalg.norm(CENTRES[chosen][:, None] - CENTRES[chosen], axis=2)
    assert len(chosen) > 20
    assert spaces[~np.eye(len(chosen), dtype=bool)].min() > 0.5


def test_maps_are_read(tmp_path):
    more = np.zeros(7)  # of a finer mesh, whose first vertices these are
    for name, values in (
        ("eccen", MAPS.eccentricity),
        ("angle", MAPS.angle),
        ("varea", MAPS.area),
    ):
        brain_files.write_values(tmp_path / f"lh.benson14_{name}.v4_0.mgz", np.r_[values, more])
    read = retinotopy.read_maps(tmp_path, "lh", BALL)
    np.testing.assert_allclose(read.eccentricity, MAPS.eccentricity, rtol=1e-6)
    np.testing.assert_array_equal(read.area, MAPS.area)

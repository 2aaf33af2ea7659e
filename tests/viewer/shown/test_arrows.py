from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from abfm import TriangleMesh
from abfm.calculus import face_normals, fast_speed
from abfm.maps import spread_points
from abfm.mesh.shapes import five_limbs
from abfm_viewer.shown.arrows import ArrowStyle, arrow_spacing, arrows_of, places
from abfm_viewer.shown.eye import Eye
from tests.shapes import icosphere, square, torus

BALL, LIMBS, RING = icosphere(4), five_limbs(2000), torus(60, 30)
STYLE = ArrowStyle(length=0.12, spacing=0.06)
FRONT = Eye(np.eye(3))


def rotation(mesh, axis=(0, 0, 1.0)):
    field = np.cross(axis, mesh.vertices[mesh.faces].mean(axis=1))
    normals = face_normals(mesh)
    return field - (field * normals).sum(axis=1, keepdims=True) * normals


def lengths(arrows):
    return np.linalg.norm(np.diff(arrows.spines, axis=1), axis=2).sum(axis=1)


def axes(seed):
    found = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return found * np.linalg.det(found)


def tilted(angle):
    """Return the axes of an eye that looks along z, tilted by an angle."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])


def test_arrow_length_is_proportional_to_speed():
    arrows = arrows_of(BALL, rotation(BALL), STYLE)
    feet, middles, tips = np.moveaxis(arrows.spines, 1, 0)
    expected = np.cross([0, 0, 1.0], BALL.length_scale * middles)
    speed, along = np.linalg.norm(expected, axis=1), tips - feet
    cosines = (along * expected).sum(axis=1) / np.linalg.norm(along, axis=1) / speed
    assert cosines.min() > 0.99
    half = np.linalg.norm(feet - middles, axis=1)
    np.testing.assert_allclose(half, lengths(arrows) / 2, rtol=0.1)
    slow = speed < 0.8 * fast_speed(BALL, np.linalg.norm(rotation(BALL), axis=1))
    per_speed = lengths(arrows)[slow] / speed[slow]
    assert 0.2 < slow.mean() < 0.8
    np.testing.assert_allclose(per_speed, np.median(per_speed), rtol=0.03)
    assert lengths(arrows).max() == pytest.approx(0.92 * STYLE.spacing, rel=0.01)


@pytest.mark.parametrize("mesh", [BALL, LIMBS], ids=["ball", "limbs"])
@pytest.mark.parametrize("style", [STYLE, ArrowStyle(1.0, 0.045)], ids=["few", "many"])
def test_arrows_do_not_overlap(mesh, style):
    arrows = arrows_of(mesh, rotation(mesh), style)
    shares = np.linspace(0, 1, 6)[:, None, None]
    feet, middles, tips = np.moveaxis(arrows.spines, 1, 0)
    places = np.concatenate([feet + shares * (middles - feet), middles + shares * (tips - middles)])
    owners = np.tile(np.arange(len(feet)), len(places))
    normals = arrows.normals.mean(axis=1)
    distances = cdist(*[places.reshape(-1, 3)] * 2)
    other_side = normals @ normals.T < -0.5
    same = owners[:, None] == owners
    distances[same | other_side[owners[:, None], owners]] = 9
    assert len(feet) > 100
    assert distances.min() > 0.06 * style.spacing


def test_length_of_style_scales_all_arrows():
    long, short = (arrows_of(BALL, rotation(BALL), ArrowStyle(x, 0.06)) for x in (0.03, 0.01))
    np.testing.assert_allclose(lengths(long), 3 * lengths(short), rtol=0.01)
    np.testing.assert_allclose(long.spines[:, 1], short.spines[:, 1])


def test_places_do_not_depend_on_the_field():
    one, other = (
        arrows_of(BALL, rotation(BALL, axis), STYLE).spines[:, 1]
        for axis in ((0, 0, 1.0), (1, 0, 0))
    )
    both = cdist(one, other).min(axis=1) == 0
    assert both.mean() > 0.9  # elsewhere one of both fields is slow
    again = arrows_of(BALL, rotation(BALL), STYLE)
    np.testing.assert_array_equal(again.vertices, arrows_of(BALL, rotation(BALL), STYLE).vertices)
    turn = axes(3)
    moved = TriangleMesh(50 * BALL.vertices @ turn.T, BALL.faces)
    there = arrows_of(moved, 7 * rotation(BALL) @ turn.T, STYLE)
    np.testing.assert_allclose(there.vertices, again.vertices @ turn.T, atol=1e-7)


def test_arrows_are_only_where_the_field_is_fast():
    centres = BALL.vertices[BALL.faces].mean(axis=1)
    local = rotation(BALL) * np.exp(-((centres[:, :1] - 1) ** 2 + centres[:, 2:] ** 2) / 0.05)
    local += 1e-3 * rotation(BALL)
    arrows = arrows_of(BALL, local, STYLE)
    assert 5 < len(arrows.spines) < 0.2 * len(arrows_of(BALL, rotation(BALL), STYLE).spines)
    assert (arrows.spines[:, 1, 0] > 0).all()
    wild = rotation(BALL)
    wild[17] *= 1e6
    found = np.median(lengths(arrows_of(BALL, wild, STYLE)))
    assert found == pytest.approx(np.median(lengths(arrows_of(BALL, rotation(BALL), STYLE))))
    faint = arrows_of(BALL, 1e-100 * rotation(BALL), STYLE)
    np.testing.assert_allclose(lengths(faint), lengths(arrows_of(BALL, rotation(BALL), STYLE)))
    assert len(arrows_of(BALL, 0 * wild, STYLE).spines) == 0


def test_field_in_one_face_has_one_arrow():
    mesh = icosphere(3)
    field = np.zeros((len(mesh.faces), 3))
    a, b, _ = mesh.vertices[mesh.faces[100]]
    field[100] = 1e-100 * (b - a)
    assert len(arrows_of(mesh, field, STYLE).spines) == 1


def test_fast_speed_sets_the_scale():
    slow, fast = (arrows_of(BALL, x * rotation(BALL), replace(STYLE, fast=1.0)) for x in (0.5, 1.0))
    assert lengths(slow).max() == pytest.approx(0.5 * lengths(fast).max(), rel=0.01)


def test_arrows_are_close_above_the_surface():
    arrows = arrows_of(LIMBS, rotation(LIMBS), STYLE)
    above = arrows.vertices + arrows.heights[:, None] * arrows.normals
    unit = LIMBS.normalized()
    distance = np.sqrt(nearest(unit, above.reshape(-1, 3)))
    assert distance.max() < 0.0025
    assert distance.min() > 0.0005
    a, b, c = np.moveaxis(above.reshape(-1, 3)[arrows.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    outwards = (normals * arrows.normals.reshape(-1, 3)[arrows.faces[:, 0]]).sum(axis=1)
    assert (outwards > -1e-9).mean() > 0.99


def nearest(mesh, places):
    import igl

    return igl.point_mesh_squared_distance(places, mesh.vertices, mesh.faces)[0]


def are_hidden(places, normals, axes):
    """Return which places on the ring face away, or are more than 0.01 behind a face, by rays."""
    import igl

    mesh, towards = RING.normalized(), axes[2]
    rays = ((place + 0.01 * towards, towards, mesh.vertices, mesh.faces) for place in places)
    return (normals @ towards <= 0) | [len(igl.ray_mesh_intersect(*ray)) > 0 for ray in rays]


@pytest.mark.parametrize("tilt", [1.3, 1.4])
def test_arrows_are_complete_or_absent_at_outlines(tilt):
    """No face is in front of a drawn vertex, and its normal points towards the eye."""
    arrows, eye = arrows_of(RING, rotation(RING), STYLE), Eye(tilted(tilt))
    hidden = arrows.hidden(eye)
    drawn = arrows.seen(eye, hidden).reshape(arrows.vertices.shape)
    is_there = np.ptp(drawn, axis=1).max(axis=1) > 0
    assert 0.1 < is_there.mean() < 0.5
    assert not is_there[hidden].any()
    assert ((arrows.normals @ eye.axes[2]) > 0.29)[is_there].all()
    places, normals = drawn[is_there].reshape(-1, 3), arrows.normals[is_there].reshape(-1, 3)
    assert are_hidden(places, normals, eye.axes).mean() < 0.002
    # omitted arrows would be cut, or are near an outline
    omitted = ~is_there & (arrows.facing(eye) > 0.35)
    places, normals = (x[omitted] for x in (arrows.vertices, arrows.normals))
    assert len(places) > 3
    covered = are_hidden(places.reshape(-1, 3), normals.reshape(-1, 3), eye.axes)
    assert covered.reshape(len(places), -1).any(axis=1).mean() > 0.9


def test_distant_perspective_equals_parallel_projection():
    arrows = arrows_of(LIMBS, rotation(LIMBS), STYLE)
    parallel = Eye(axes(1))
    far = Eye(parallel.axes, 200 * parallel.axes[2])
    assert (arrows.hidden(far) == arrows.hidden(parallel)).mean() > 0.99
    near = Eye(parallel.axes, 3 * parallel.axes[2])
    assert not np.array_equal(near.towards(arrows.spines), parallel.towards(arrows.spines))
    assert (arrows.hidden(near) == arrows.hidden(parallel)).mean() > 0.85


def test_open_surface_has_arrows_on_the_visible_side():
    mesh = square(10)
    arrows = arrows_of(mesh, np.tile([1.0, 0.5, 0], (len(mesh.faces), 1)), STYLE)
    assert len(arrows.spines) > 100
    assert arrows.vertices[..., :2].min() >= -1e-9
    assert arrows.vertices[..., :2].max() <= 1 + 1e-9
    for sign in (1, -1):
        eye = Eye(np.diag([sign, 1.0, sign]))
        assert not arrows.hidden(eye).any()
        assert (sign * arrows.seen(eye)[:, 2] > 0.001).all()


def test_spacing_in_pixels_does_not_depend_on_size():
    scales = np.geomspace(250, 1500, 40)
    pixels = np.array([scale * arrow_spacing(0.5, scale) for scale in scales])
    assert 24 < pixels.min() < pixels.max() < 37
    dense = [arrow_spacing(density, 700) for density in (0.0, 0.5, 1.0)]
    assert dense[0] > dense[1] > dense[2]
    assert arrow_spacing(1.0, 1e9) > 0
    assert arrow_spacing(0.0, 1e-9) < 1


def test_more_arrows_are_visible_if_the_eye_is_known():
    whole, style = np.zeros(2), ArrowStyle(1.0, 0.12, fast=1e-9)
    for seed in range(3):
        eye = Eye(axes(seed))
        for way in eye.axes:  # all arrows have the full length
            for k, own in enumerate((None, eye)):
                arrows = arrows_of(LIMBS, rotation(LIMBS, way), style, own)
                whole[k] += (~arrows.hidden(eye)).sum()
        spread = spread_points(LIMBS).points.positions
        distances = cdist(spread, places(LIMBS, style.spacing, eye).positions) / LIMBS.length_scale
        assert distances.min(axis=1).max() < 1.5 * style.spacing
    assert whole[1] > 1.1 * whole[0]


@pytest.mark.parametrize("eye", [None, Eye(axes(4))], ids=["no eye", "an eye"])
def test_spacing_holds_on_each_side_of_a_thin_part(eye):
    points, normals = places(LIMBS, 0.06, eye), spread_points(LIMBS).normals
    spread = spread_points(LIMBS).points.positions
    normals = normals[cdist(points.positions, spread).argmin(axis=1)]
    at = points.positions / LIMBS.length_scale
    distances = cdist(at, at) + 9 * ((normals @ normals.T <= -0.5) | np.eye(len(at), dtype=bool))
    assert distances.min() > 0.06 * (1 - 1e-5)
    assert len(at) > 100


def test_visible_places_stay_while_the_surface_turns():
    seen = []
    for angle in (0.0, 0.1):
        eye = Eye(tilted(angle))
        found = places(BALL, 0.05, eye).positions
        seen.append(found[found @ eye.axes[2] > 0.75])
    both = cdist(*seen).min(axis=1) == 0
    assert len(both) > 25
    assert both.mean() > 0.8
    base = spread_points(BALL).with_spacing(0.05).positions
    assert (cdist(seen[0], base).min(axis=1) == 0).all()


def test_arrow_does_not_bend_around_a_sharp_edge():
    mesh = icosphere(0)
    arrows = arrows_of(mesh, rotation(mesh), ArrowStyle(1.0, 0.13), Eye(axes(5)))
    cosines = np.einsum("amx,anx->amn", arrows.normals, arrows.normals)
    assert len(arrows.spines)
    assert cosines.min() > 2 * 0.6**2 - 1  # both ends are within one angle of the middle

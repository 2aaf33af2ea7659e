"""Quantities of a field, computed once for each field in the background."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

import abfm
from abfm import AbfmError, Parameters
from abfm.calculus import commuting_fields, gradient, pushforward, relative_bracket, to_ambient
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import NO_VALUES, linear_table
from abfm_viewer.files.documents import document_of_sequence
from abfm_viewer.shown import quantities as quantities_module
from abfm_viewer.shown.colored_values import ColoredValues
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.quantities import Field, pushed_gradient
from abfm_viewer.shown.streak_texture import SHADE, streak_texture
from tests.core.fields import rotation_field
from tests.core.sequences.rotating_sphere import solved
from tests.core.streaks.texel_weights import texel_weights
from tests.messages import raises
from tests.shapes import icosphere
from tests.viewer.sessions import SPHERE, matched, until


@pytest.fixture(autouse=True)
def _coarse(monkeypatch):
    monkeypatch.setattr(quantities_module, "TEXELS", 128)


@pytest.fixture
def convolutions(monkeypatch):
    """Return a list that grows with each convolution."""
    seen, convolve = [], abfm.streaks.line_integral_convolution

    def counted(*arguments, **options):
        seen.append(arguments)
        return convolve(*arguments, **options)

    monkeypatch.setattr(abfm.streaks, "line_integral_convolution", counted)
    return seen


def colors_of(session):
    return color_range(session.values("source"), session.values("target"))


def values_of(shown):
    return ColoredValues(shown.flow.advected(), colors_of(shown.session))


def texture(shown):
    """Return the streaks with the present colours, when all computations are done."""
    found = None

    def is_final():
        nonlocal found
        # the computation may have ended after the request
        before, was_busy = found, shown.flow.busy or shown.quantities.busy
        found = shown.quantities.texture(values_of(shown))
        is_busy = was_busy or shown.flow.busy or shown.quantities.busy
        return found is not None and found is before and not is_busy

    until(is_final, shown.session)
    return found


def test_streaks_are_computed_once_for_each_result(session, shown, convolutions):
    at_end = texture(shown)
    assert texture(shown) is at_end
    session.set_time(0.0)
    at_start = texture(shown)
    assert at_start.streaks is at_end.streaks
    assert abs(at_start.colors - at_end.colors).max() > 0.2
    assert len(convolutions) == 1
    session.editor.set_parameter(alpha=1.0)
    matched(session)
    assert texture(shown).streaks is not at_end.streaks
    assert len(convolutions) == 2


def test_pending_computations_are_named(session, shown, held):
    _, may_decompose = held(abfm.calculus, "helmholtz_hodge")
    _, may_convolve = held(abfm.streaks, "line_integral_convolution")
    until(lambda: not shown.busy, session)
    session.editor.set_view("show", part="curl-free", streaks=True)
    shown.quantities.field()
    assert shown.busy == "computing the field"
    may_decompose.set()
    until(lambda: shown.quantities.field() and not shown.quantities.is_computing_field, session)
    assert shown.busy == ""
    assert shown.quantities.texture(values_of(shown)) is None
    assert shown.busy == "computing streaks"
    may_convolve.set()
    texture(shown)
    assert shown.busy == ""
    _, may_place = held(abfm.maps, "spread_points")
    session.editor.set_view("show", streaks=False, arrows=True)
    place = partial(shown.quantities.arrows, shown.quantities.field(), 100.0, Eye(np.eye(3)))
    assert place() is None
    assert shown.busy == "placing arrows"
    may_place.set()
    until(lambda: place() is not None, session)
    assert shown.busy == ""


def test_sequence_caches_streaks_of_intervals(session, shown, held, convolutions):
    document = document_of_sequence(solved(), Path("frames.npz"))
    session.restore(document, {}, None)
    session.editor.set_view("show", streaks=True)
    colors = color_range(*document.sequence.columns[0])
    begins, may_convolve = held(abfm.streaks, "line_integral_convolution")

    def at(time):
        session.editor.amend(time=time)
        return shown.quantities.texture(ColoredValues(shown.flow.advected(), colors))

    session.player.toggle()
    times = document.sequence.middles.tolist()
    until(lambda: at(times[0]) is not None or begins.is_set(), session)
    assert at(times[0]) is None
    assert (shown.quantities.convolving, shown.is_ready) == (True, True)
    may_convolve.set()
    velocity = document.result.velocity

    def of_interval(interval):
        """Return the streaks of an interval, as soon as they are shown."""
        found = None

        def is_there():
            nonlocal found
            found = at(times[interval])
            return found and np.array_equal(found.streaks.field.velocity, velocity[interval])

        until(is_there, session)
        return found.streaks

    found = [of_interval(interval) for interval in range(len(times))]
    count = len(convolutions)
    assert all(of_interval(k) is streaks for k, streaks in enumerate(found))
    assert len(convolutions) == count == len(times)
    session.player.toggle()


def test_streaks_darken_colors_of_the_function(session, shown):
    found = texture(shown)
    atlas, values, colors = found.streaks.atlas, shown.flow.advected(), colors_of(session)
    white = np.ones((atlas.size, atlas.size), dtype=np.float32)
    bright = streak_texture(atlas, white, ColoredValues(values, colors))
    assert (found.colors <= bright + 1e-6).all()
    assert (found.colors >= (1 - SHADE) * bright - 1e-6).all()
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    corners = values[atlas.mesh.faces[atlas.texel_faces[rows, columns]]]
    function = np.einsum("pc,pc->p", texel_weights(atlas, rows, columns), corners)
    share = np.clip((function - colors.low) / (colors.high - colors.low), 0, 1)
    expected = linear_table(colors.colormap, 1024)[(1023 * share + 1e-6).astype(int)]
    np.testing.assert_allclose(bright[rows, columns], expected, rtol=0, atol=0.01)
    unknown = np.arange(len(values)) == 5
    lacking = streak_texture(atlas, white, ColoredValues(values, colors, unknown))
    around = unknown[atlas.mesh.faces[atlas.texel_faces]].any(axis=2) & (atlas.texel_faces >= 0)
    np.testing.assert_allclose(lacking[around], NO_VALUES, atol=1e-6)
    np.testing.assert_array_equal(lacking[~around], bright[~around])
    black, nowhere = np.zeros_like(white), np.zeros(len(atlas.mesh.faces))
    faint = streak_texture(atlas, black, ColoredValues(values, colors, determined=nowhere))
    np.testing.assert_allclose(faint[rows, columns], bright[rows, columns], atol=1e-6)
    mixed = ColoredValues(values, colors, determined=nowhere + 0.25, plain=(0.2, 0.4, 0.6))
    pale = streak_texture(atlas, white, mixed)[rows, columns]
    expected = 0.25 * bright[rows, columns] + 0.75 * np.array([0.2, 0.4, 0.6])
    np.testing.assert_allclose(pale, expected, atol=1e-6)
    full = streak_texture(atlas, black, ColoredValues(values, colors, determined=nowhere + 1))
    np.testing.assert_allclose(full, (1 - SHADE) * bright, atol=1e-6)
    of_faces = values[atlas.mesh.faces].mean(axis=1)
    colored = ColoredValues(of_faces, colors, of_faces > 0.9, of_faces=True)
    flat = streak_texture(atlas, white, colored)
    face = atlas.texel_faces[rows, columns]
    share = np.clip((of_faces - colors.low) / (colors.high - colors.low), 0, 1)
    expected = linear_table(colors.colormap, 1024)[(1023 * share + 1e-6).astype(int)]
    expected[of_faces > 0.9] = NO_VALUES
    np.testing.assert_allclose(flat[rows, columns], expected[face], rtol=0, atol=1e-6)
    image = found.streaks.images[0]
    grey = streak_texture(atlas, image)
    of_shares = streak_texture(atlas, (image / 255).astype(np.float32))
    np.testing.assert_allclose(grey, of_shares, atol=1e-6)
    assert (grey[..., 0] == grey[..., 2]).all()
    assert grey[image == 255].min() > grey[image == 0].max()


def test_moving_streaks_are_periodic(session, shown, convolutions):
    session.editor.set_view("show", animate=True)
    first = texture(shown)
    streaks = first.streaks
    assert len(streaks.images) == quantities_module._PHASES
    session.player.phase = (session.player.phase + 0.4) % 1
    second = texture(shown)
    assert second.streaks is streaks
    assert abs(second.colors - first.colors).max() > 0.1
    assert len(convolutions) == 1
    images = streaks.images.astype(float)
    np.testing.assert_array_equal(streaks.at(0.0), streaks.at(1.0))
    np.testing.assert_array_equal(streaks.at(3 / len(images)), images[3])
    between = streaks.at(1 - 0.25 / len(images))
    np.testing.assert_allclose(between, 0.25 * images[-1] + 0.75 * images[0], rtol=0, atol=0.51)
    steps = np.abs(np.roll(images, -1, axis=0) - images).mean(axis=(1, 2))
    assert steps.max() < 1.5 * steps.min()


def test_fading_streaks_have_less_contrast(session, shown, convolutions):
    full = texture(shown).streaks
    session.editor.set_view("show", fade=True)
    faded = texture(shown).streaks
    faces = full.atlas.texel_faces
    slow = (faces >= 0) & (faded.field.speed[faces] < 0.2 * faded.field.speed.max())
    assert faded.images[0][slow].std() < 0.35 * full.images[0][slow].std()
    assert len(convolutions) == 2


def shown_field(shown, part):
    """Return the field of a part of the view, when all computations are done."""
    session = shown.session
    session.editor.set_view("show", part=part)
    shown.quantities.field()
    until(lambda: not shown.quantities.busy and shown.quantities.field() is not None, session)
    return shown.quantities.field()


def test_commuting_field_has_a_note_on_its_bracket(session, shown):
    velocity = session.result.velocity[0]
    found = shown_field(shown, "commuting")
    np.testing.assert_array_equal(found.velocity, commuting_fields(SPHERE, velocity)[0])
    assert f"{relative_bracket(SPHERE, velocity, found.velocity):.3g}" in found.note
    assert not shown.quantities.error


def gradient_of(mesh, function):
    return to_ambient(mesh, (gradient(mesh) @ function).reshape(-1, 2))


def test_gradient_is_pushed_to_the_shown_time(session, shown):
    start, tau = gradient_of(SPHERE, session.values("source")), session.parameters.tau
    for time in (0.0, 0.5 * tau, tau):
        session.set_time(time)
        found = shown_field(shown, "pushed gradient").velocity
        expected = pushforward(SPHERE, session.result.velocity[0], start, time)
        np.testing.assert_allclose(found, expected, atol=1e-9 * abs(expected).max())


def test_gradient_is_pushed_along_several_fields():
    mesh = icosphere(2)
    velocity = np.stack([rotation_field(mesh, axis) for axis in np.eye(3)])
    flow = FlowState(mesh, velocity, Parameters.of(tau=0.6, segments=3))
    f = mesh.vertices[:, 0] * mesh.vertices[:, 1]
    first = pushforward(mesh, velocity[0], gradient_of(mesh, f), 0.2)
    second = pushforward(mesh, velocity[1], first, 0.2)
    for time, expected in (
        (0.2, first),
        (0.5, pushforward(mesh, velocity[2], second, 0.1)),
        (1.0, pushforward(mesh, velocity[2], second, 0.6)),
    ):
        found = pushed_gradient(flow, f, time).velocity
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_missing_commuting_field_has_a_reason(session, shown, monkeypatch):
    flow = shown.flow.state
    for factor, final in ((0, True), (1, False)):
        state = FlowState(flow.mesh, factor * flow.velocity, flow.parameters, final)
        with raises(AbfmError):
            quantities_module.commuting(state, 0)
    monkeypatch.setattr(quantities_module, "_COMMUTING_VERTICES_MAX", 100)
    for part, facts in (("commuting", ("100", "642")), ("complete", ())):
        session.editor.set_view("show", part=part)
        shown.quantities.field()
        until(lambda: not shown.quantities.busy, session)
        error = shown.quantities.error
        assert bool(error) == bool(facts)
        assert all(fact in error for fact in facts)


def test_earlier_field_is_shown_again_at_once(session, shown, held):
    begun, may_end = held(
        quantities_module, "field_part", lambda flow, segment, part: part == "commuting"
    )
    session.editor.set_view("arrows", arrows=True)
    until(lambda: shown.quantities.field() is not None, session)
    field = shown.quantities.field()
    assert np.array_equal(field.velocity, session.result.velocity[0])
    session.editor.set_view("part", part="commuting")
    until(lambda: shown.quantities.field() is not None and begun.is_set(), session)
    session.editor.set_view("part", part="complete")
    assert shown.quantities.field() is field
    may_end.set()
    until(lambda: not shown.quantities._field.is_running, session)
    assert shown.quantities.field() is field
    assert shown.busy == ""
    session.editor.set_view("part", part="commuting")
    until(lambda: shown.quantities.field() is not field, session)
    assert not np.array_equal(shown.quantities.field().velocity, field.velocity)


def test_huge_speeds_are_in_square_roots_of_area():
    mesh, unit = icosphere(1), "the mesh's unit per second"
    velocity = np.ones((len(mesh.faces), 3))
    speed = np.linalg.norm(velocity, axis=1)
    slow = Field(mesh, velocity, speed, unit=unit, interval_field=velocity)
    assert slow.relative_speed()[1] == unit
    np.testing.assert_array_equal(slow.relative_speed()[0], speed)
    fast = Field(mesh, velocity, 1e31 * speed, unit=unit, interval_field=velocity)
    assert fast.relative_speed()[1] == "sqrt(area) per second"
    np.testing.assert_allclose(fast.relative_speed()[0], 1e31 * speed / mesh.length_scale)

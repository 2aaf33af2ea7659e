"""What is told of the field, computed in the background once for the same field."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm import AbfmError, Parameters
from abfm.calculus.operators import gradient
from abfm.calculus.vector_fields import commuting_fields, pushforward, relative_bracket, to_ambient
from abfm_viewer.appearance.colormaps import color_range, linear_table
from abfm_viewer.shown import field_quantities
from abfm_viewer.shown.field_quantities import carried_gradient
from abfm_viewer.shown.shown import Shown
from abfm_viewer.shown.shown_flow import FlowState
from abfm_viewer.shown.streak_texture import SHADE, streak_texture
from tests.core.fields import rotation_field
from tests.core.texel_weights import texel_weights
from tests.shapes import icosphere
from tests.viewer.sessions import opened, until


@pytest.fixture
def session(monkeypatch):
    monkeypatch.setattr(field_quantities, "_TEXELS", 128)
    session = opened()
    session.match()
    until(lambda: session.solver.finished, session)
    yield session
    session.close()


@pytest.fixture
def shown(session):
    shown = Shown(session)
    yield shown
    shown.close()


@pytest.fixture
def convolutions(monkeypatch):
    """How many there were."""
    seen = []
    convolve = abfm.streaks.line_integral_convolution

    def counted(*arguments, **options):
        seen.append(arguments)
        return convolve(*arguments, **options)

    monkeypatch.setattr(abfm.streaks, "line_integral_convolution", counted)
    return seen


def show(session, **values):
    session.editor.amend(view=replace(session.view, **values))


def texture(shown):
    """The streaks coloured by what is advected now, when there is nothing better to come."""
    session = shown.session
    values = session.values("source"), session.values("target")
    found = None

    def is_final():
        nonlocal found
        advected = shown.flow.advected()
        found = shown.quantities.texture(advected, color_range(*values))
        return found is not None and not shown.flow.busy and not shown.quantities.busy

    until(is_final, session)
    return found


def test_streaks_are_computed_once_and_take_the_colours_of_every_time(session, shown, convolutions):
    at_end = texture(shown)
    assert texture(shown) is at_end
    session.set_time(0.0)
    at_start = texture(shown)
    assert at_start.streaks is at_end.streaks
    assert abs(at_start.colors - at_end.colors).max() > 0.2
    assert len(convolutions) == 1


def test_what_is_still_to_come_is_said(session, shown, monkeypatch):
    may_go_on = threading.Event()
    decompose, convolve = abfm.calculus.helmholtz_hodge, abfm.streaks.line_integral_convolution

    def late(job):
        def work(*arguments, **options):
            assert may_go_on.wait(30)
            return job(*arguments, **options)

        return work

    monkeypatch.setattr(abfm.calculus, "helmholtz_hodge", late(decompose))
    monkeypatch.setattr(abfm.streaks, "line_integral_convolution", late(convolve))
    until(lambda: not shown.busy, session)
    show(session, part="curl-free", streaks=True)
    shown.quantities.field()
    assert shown.busy == "computing the field"
    may_go_on.set()
    until(lambda: shown.quantities.field() and not shown.quantities.finding, session)
    assert shown.busy == ""
    may_go_on.clear()
    colors = color_range(session.values("source"), session.values("target"))
    assert shown.quantities.texture(shown.flow.advected(), colors) is None
    assert shown.busy == "computing streaks"
    may_go_on.set()
    texture(shown)
    assert shown.busy == ""


def test_coloured_streaks_are_those_of_the_function_and_darker(session, shown):
    found = texture(shown)
    atlas, values = found.streaks.atlas, shown.flow.advected()
    colors = color_range(session.values("source"), session.values("target"))
    bright = streak_texture(
        atlas, np.ones((atlas.size, atlas.size), dtype=np.float32), values, colors
    )
    assert (found.colors <= bright + 1e-6).all()
    assert (found.colors >= (1 - SHADE) * bright - 1e-6).all()
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    function = np.einsum(
        "pc,pc->p",
        texel_weights(atlas, rows, columns),
        values[atlas.mesh.faces[atlas.texel_faces[rows, columns]]],
    )
    share = np.clip((function - colors.low) / (colors.high - colors.low), 0, 1)
    expected = linear_table(colors.colormap, 1024)[(1023 * share + 1e-6).astype(int)]
    np.testing.assert_allclose(bright[rows, columns], expected, rtol=0, atol=0.01)


def test_streaks_without_a_function_are_grey(shown):
    found = texture(shown)
    image = found.streaks.images[0]
    grey = streak_texture(found.streaks.atlas, image)
    np.testing.assert_allclose(
        grey, streak_texture(found.streaks.atlas, (image / 255).astype(np.float32)), atol=1e-6
    )
    assert (grey[..., 0] == grey[..., 2]).all()
    assert grey[image == 255].min() > grey[image == 0].max()


def test_moving_streaks_are_computed_once_for_all_phases(session, shown, convolutions):
    show(session, animate=True)
    first = texture(shown)
    assert len(first.streaks.images) == field_quantities._PHASES
    session.player.phase = (session.player.phase + 0.4) % 1
    second = texture(shown)
    assert second.streaks is first.streaks
    assert abs(second.colors - first.colors).max() > 0.1
    assert len(convolutions) == 1


def test_phases_between_are_blended_and_the_last_leads_to_the_first(session, shown):
    show(session, animate=True)
    streaks = texture(shown).streaks
    images = streaks.images.astype(float)
    np.testing.assert_array_equal(streaks.at(0.0), streaks.at(1.0))
    np.testing.assert_array_equal(streaks.at(3 / len(images)), images[3])
    between = streaks.at(1 - 0.25 / len(images))
    np.testing.assert_allclose(between, 0.25 * images[-1] + 0.75 * images[0], rtol=0, atol=0.51)
    steps = [
        np.abs(after - before).mean()
        for before, after in zip(images, np.roll(images, -1, axis=0), strict=True)
    ]
    assert max(steps) < 1.5 * min(steps)


def test_fading_streaks_have_less_contrast(session, shown, convolutions):
    full = texture(shown).streaks
    show(session, fade=True)
    faded = texture(shown).streaks
    used = full.atlas.texel_faces >= 0
    slow = faded.field.speed[full.atlas.texel_faces] < 0.2 * faded.field.speed.max()
    assert faded.images[0][used & slow].std() < 0.35 * full.images[0][used & slow].std()
    assert len(convolutions) == 2


def test_another_result_has_other_streaks(session, shown, convolutions):
    first = texture(shown)
    session.editor.set_parameter(alpha=1.0)
    session.match()
    until(lambda: session.solver.finished, session)
    assert texture(shown).streaks is not first.streaks
    assert len(convolutions) == 2


def shown_field(shown, part):
    """The field that a part of the view gives, when there is nothing better to come."""
    session = shown.session
    session.editor.set_view("show", part=part)
    shown.quantities.field()
    until(lambda: not shown.quantities.busy and shown.quantities.field() is not None, session)
    return shown.quantities.field()


def test_the_commuting_field_is_that_of_the_flow_and_says_how_well_it_commutes(session, shown):
    velocity = session.result.velocity[0]
    found = shown_field(shown, "commuting")
    np.testing.assert_array_equal(
        found.velocity, commuting_fields(session.surface().mesh, velocity)[0]
    )
    assert f"{relative_bracket(session.surface().mesh, velocity, found.velocity):.3g}" in found.note
    assert not shown.quantities.error


def test_the_sources_gradient_is_carried_to_the_shown_time(session, shown):
    source, tau = session.values("source"), session.parameters.tau
    start = to_ambient(
        session.surface().mesh, (gradient(session.surface().mesh) @ source).reshape(-1, 2)
    )
    for time in (0.0, 0.5 * tau, tau):
        session.set_time(time)
        found = shown_field(shown, "carried gradient").velocity
        expected = pushforward(session.surface().mesh, session.result.velocity[0], start, time)
        np.testing.assert_allclose(found, expected, atol=1e-9 * abs(expected).max())


def test_a_gradient_is_carried_along_several_fields_one_after_the_other():
    mesh = icosphere(2)
    velocity = np.stack([rotation_field(mesh, axis) for axis in np.eye(3)])
    flow = FlowState(mesh, velocity, Parameters(tau=0.6, segments=3))
    f = mesh.vertices[:, 0] * mesh.vertices[:, 1]
    start = to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
    after = pushforward(mesh, velocity[0], start, 0.2)
    np.testing.assert_allclose(carried_gradient(flow, f, 0.2).velocity, after, atol=1e-12)
    after = pushforward(mesh, velocity[1], after, 0.2)
    np.testing.assert_allclose(
        carried_gradient(flow, f, 0.5).velocity,
        pushforward(mesh, velocity[2], after, 0.1),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        carried_gradient(flow, f, 1.0).velocity,
        pushforward(mesh, velocity[2], after, 0.6),
        atol=1e-12,
    )


def test_a_commuting_field_that_cannot_be_computed_says_why(session, shown, monkeypatch):
    flow = shown.flow.state
    with pytest.raises(AbfmError, match="zero"):
        field_quantities.commuting(FlowState(flow.mesh, 0 * flow.velocity, flow.parameters), 0)
    with pytest.raises(AbfmError, match="ended"):
        field_quantities.commuting(
            FlowState(flow.mesh, flow.velocity, flow.parameters, final=False), 0
        )
    monkeypatch.setattr(field_quantities, "_LARGEST", 100)
    session.editor.set_view("show", part="commuting")
    shown.quantities.field()
    until(lambda: not shown.quantities.busy, session)
    assert "up to 100 vertices; this mesh has 642" in shown.quantities.error
    session.editor.set_view("show", part="whole")
    shown.quantities.field()
    until(lambda: not shown.quantities.busy, session)
    assert not shown.quantities.error

"""What is told of the field, computed in the background once for the same field."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import AbfmError, Parameters, line_integral
from abfm.commuting_fields import commuting_fields, relative_bracket
from abfm.operators import gradient
from abfm.vector_fields import pushforward, to_ambient
from abfm_viewer import field_quantities, related_fields
from abfm_viewer.colormaps import color_range
from abfm_viewer.related_fields import carried_gradient
from abfm_viewer.streak_texture import SHADE
from abfm_viewer.transport import FlowState
from tests.core.fields import rotation_field
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
def convolutions(monkeypatch):
    """How many there were."""
    seen = []
    convolve = line_integral.line_integral_convolution

    def counted(*arguments, **options):
        seen.append(arguments)
        return convolve(*arguments, **options)

    monkeypatch.setattr(line_integral, "line_integral_convolution", counted)
    return seen


def texture(session):
    """The streaks coloured by what is advected now, when there is nothing better to come."""
    values = session.values("source"), session.values("target")
    found = None

    def is_final():
        nonlocal found
        advected = session.shown.advected()
        found = session.quantities.texture(session, advected, color_range(*values))
        return found is not None and not session.shown.busy and not session.quantities.busy

    until(is_final, session)
    return found


def test_streaks_are_computed_once_and_take_the_colours_of_every_time(session, convolutions):
    at_end = texture(session)
    assert texture(session) is at_end
    session.set_time(0.0)
    at_start = texture(session)
    assert at_start.streaks is at_end.streaks
    assert abs(at_start.colors - at_end.colors).max() > 0.2
    assert len(convolutions) == 1


def test_coloured_streaks_are_those_of_the_function_and_darker(session):
    found = texture(session)
    plain = found.streaks.atlas.image(session.shown.advected())
    colors = color_range(session.values("source"), session.values("target"))
    bright = field_quantities._texture(
        field_quantities.Streaks(found.streaks.field, found.streaks.atlas, np.ones_like(plain)),
        session.shown.advected(),
        colors,
    ).colors
    assert (found.colors <= bright + 1e-6).all()
    dark = 1 - SHADE
    assert (found.colors >= dark * bright - 1e-6).all()


def test_another_result_has_other_streaks(session, convolutions):
    first = texture(session)
    session.set_parameter(alpha=1.0)
    session.match()
    until(lambda: session.solver.finished, session)
    assert texture(session).streaks is not first.streaks
    assert len(convolutions) == 2


def shown_field(session, part):
    """The field that a part of the view gives, when there is nothing better to come."""
    session.set_view("show", part=part)
    session.quantities.field(session)
    until(lambda: not session.quantities.busy and session.quantities.field(session) is not None, session)
    return session.quantities.field(session)


def test_the_commuting_field_is_that_of_the_flow_and_says_how_well_it_commutes(session):
    velocity = session.result.velocity[0]
    found = shown_field(session, "commuting")
    np.testing.assert_array_equal(found.velocity, commuting_fields(session.mesh, velocity)[0])
    assert f"{relative_bracket(session.mesh, velocity, found.velocity):.3g}" in found.note
    assert not session.quantities.error


def test_the_sources_gradient_is_carried_to_the_shown_time(session):
    source, tau = session.values("source"), session.parameters.tau
    start = to_ambient(session.mesh, (gradient(session.mesh) @ source).reshape(-1, 2))
    for time in (0.0, 0.5 * tau, tau):
        session.set_time(time)
        found = shown_field(session, "carried gradient").velocity
        expected = pushforward(session.mesh, session.result.velocity[0], start, time)
        np.testing.assert_allclose(found, expected, atol=1e-9 * abs(expected).max())


def test_a_gradient_is_carried_along_several_fields_one_after_the_other():
    mesh = icosphere(2)
    velocity = np.stack([rotation_field(mesh, axis) for axis in np.eye(3)])
    flow = FlowState(mesh, velocity, Parameters(tau=0.6, segments=3))
    f = mesh.vertices[:, 0] * mesh.vertices[:, 1]
    start = to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
    after = pushforward(mesh, velocity[0], start, 0.2)
    np.testing.assert_allclose(carried_gradient(flow, f, 0.2), after, atol=1e-12)
    after = pushforward(mesh, velocity[1], after, 0.2)
    np.testing.assert_allclose(carried_gradient(flow, f, 0.5), pushforward(mesh, velocity[2], after, 0.1), atol=1e-12)
    np.testing.assert_allclose(carried_gradient(flow, f, 1.0), pushforward(mesh, velocity[2], after, 0.6), atol=1e-12)


def test_a_commuting_field_that_cannot_be_computed_says_why(session, monkeypatch):
    flow = session.shown.flow
    with pytest.raises(AbfmError, match="zero"):
        related_fields.commuting(FlowState(flow.mesh, 0 * flow.velocity, flow.parameters), 0)
    with pytest.raises(AbfmError, match="ended"):
        related_fields.commuting(FlowState(flow.mesh, flow.velocity, flow.parameters, final=False), 0)
    monkeypatch.setattr(related_fields, "_LARGEST", 100)
    session.set_view("show", part="commuting")
    session.quantities.field(session)
    until(lambda: not session.quantities.busy, session)
    assert "up to 100 vertices; this mesh has 642" in session.quantities.error
    session.set_view("show", part="whole")
    session.quantities.field(session)
    until(lambda: not session.quantities.busy, session)
    assert not session.quantities.error

"""What is told of the field, computed in the background once for the same field."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import line_integral
from abfm_viewer import field_quantities
from abfm_viewer.colormaps import color_range
from abfm_viewer.streak_texture import SHADE
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

"""Who goes back to what was shown before, while something else is being computed, sees that, and
goes on seeing it.
"""

from __future__ import annotations

import threading

import numpy as np
import pytest

import abfm
from abfm_viewer.shown import field_quantities
from abfm_viewer.shown.shown import Shown
from tests.viewer.sessions import matched, opened, until


@pytest.fixture
def session():
    session = matched(opened())
    yield session
    session.close()


@pytest.fixture
def shown(session):
    shown = Shown(session)
    yield shown
    shown.close()


class Held:
    """A function of another module that says when it has begun, and ends when it may."""

    def __init__(self, monkeypatch, module, name, held):
        self.begun, self.may_end = threading.Event(), threading.Event()
        compute = getattr(module, name)

        def wait_and_compute(*arguments, **options):
            if held(*arguments):
                self.begun.set()
                assert self.may_end.wait(30)
            return compute(*arguments, **options)

        monkeypatch.setattr(module, name, wait_and_compute)


def test_the_whole_field_after_one_that_commutes_was_asked_for(session, shown, monkeypatch):
    held = Held(
        monkeypatch, field_quantities, "field_part", lambda flow, segment, part: part == "commuting"
    )
    session.editor.set_view("arrows", arrows=True)
    until(lambda: shown.quantities.field() is not None, session)
    whole = shown.quantities.field()
    assert np.array_equal(whole.velocity, session.result.velocity[0])
    session.editor.set_view("part", part="commuting")
    until(lambda: shown.quantities.field() is not None and held.begun.is_set(), session)
    session.editor.set_view("part", part="whole")
    assert shown.quantities.field() is whole
    held.may_end.set()
    until(lambda: not shown.quantities._field.is_at_work, session)
    assert shown.quantities.field() is whole
    assert shown.busy == ""
    session.editor.set_view("part", part="commuting")
    until(lambda: shown.quantities.field() is not whole, session)
    assert not np.array_equal(shown.quantities.field().velocity, whole.velocity)


def test_optimal_transport_at_a_time_after_another_one_was_asked_for(session, shown, monkeypatch):
    tau = session.parameters.tau
    held = Held(
        monkeypatch, abfm.baselines, "optimal_transport", lambda mesh, f, g, share: share == 0.9
    )

    def values(share):
        session.set_time(share * tau)
        return shown.mass_transport.values()

    until(lambda: values(0.5) is not None, session)
    half = values(0.5)
    until(lambda: values(0.9) is half and held.begun.is_set(), session)
    assert shown.mass_transport.is_behind
    assert values(0.5) is half
    held.may_end.set()
    until(lambda: not shown.mass_transport._values.is_at_work, session)
    assert values(0.5) is half
    assert not shown.mass_transport.is_behind
    until(lambda: values(0.9) is not half, session)

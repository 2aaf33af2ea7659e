"""A verdict's remedies, carried out without a window."""

from __future__ import annotations

from dataclasses import replace

import pytest

from abfm import Parameters
from abfm.matching import Remedy
from abfm_viewer.document.document import Channel
from tests.viewer.sessions import ENDLESS, end_run, matched, opened, until

FAR = Channel("gaussian:x=0,y=0,z=1,width=0.12", "gaussian:x=0,y=0.5,z=-0.87,width=0.12")
BLIND = Parameters(reach=0.0, iterations=40)


@pytest.fixture
def session():
    """One whose match has not reached its target."""
    session = matched(opened(BLIND, FAR))
    yield session
    session.close()


def test_the_first_remedy_of_a_far_pair_comes_closer_and_is_one_step_of_undo(session):
    before, result = session.document, session.result
    assert result.verdict.kind == "not reached"
    first = result.verdict.remedies[0]
    session.remedy(first)
    assert session.solver.running
    assert session.parameters == replace(BLIND, **first.parameters)
    until(lambda: session.solver.finished, session)
    assert session.result is not result
    assert session.result.verdict.kind in ("matched", "nearly")
    assert session.editor.history.undo_label == "reach further"
    session.undo()
    assert session.result is result
    assert session.parameters == before.parameters
    session.redo()
    assert session.result.parameters.reach == 1
    assert not session.outdated


def test_what_goes_on_starts_from_the_present_field(session):
    history = session.result.energy_history
    assert not session.solver.warm
    session.remedy(Remedy("Continue", "go on", {}, True))
    until(lambda: session.solver.finished, session)
    assert session.result.energy_history[0, 0] == pytest.approx(history[-1, 0], rel=0.1)
    assert history[:, 0].max() > 2 * history[-1, 0]
    assert session.editor.history.undo_label == "match"


def test_a_result_is_a_step_of_its_own_if_the_user_did_something_since(session):
    session.remedy(session.result.verdict.remedies[0])
    session.editor.set_view("change the layout", layout="column")
    until(lambda: session.solver.finished, session)
    assert session.editor.history.undo_label == "match"


def test_during_a_run_nothing_is_changed(session):
    remedy = session.result.verdict.remedies[0]
    session.editor.amend(parameters=ENDLESS)
    session.match()
    session.remedy(remedy)
    assert session.parameters == ENDLESS
    end_run(session)
    assert (
        session.editor.history.undo_label == "match"
    )  # the run's result is no part of a step before it

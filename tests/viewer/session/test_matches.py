import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from abfm import Parameters
from abfm.matching import Remedy
from abfm_viewer.computing.matching import Matching
from abfm_viewer.document.document import Channel, View
from abfm_viewer.files.project import Origin
from abfm_viewer.session.session import Session
from tests.messages import check_message
from tests.shapes import torus
from tests.viewer import sessions
from tests.viewer.sessions import ENDLESS, PAIR, SPHERE, end_run, matched, ready, solving, until

TORUS = torus(24, 12)
DISTANT_CHANNEL = Channel(
    "gaussian:x=0,y=0,z=1,width=0.12", "gaussian:x=0,y=0.3,z=-0.95,width=0.12"
)
BLIND = Parameters.of(reach=0.0, iterations=40, refine=0, divergence=1.0)


@pytest.fixture
def requests(monkeypatch):
    """Return the meshes and numbers of levels for which coarse meshes were made."""
    requests = []
    monkeypatch.setattr(
        Matching,
        "prepare",
        lambda _, mesh, parameters: requests.append((mesh, parameters.solver.levels)),
    )
    return requests


def test_coarse_meshes_are_prepared_once(requests, session):
    until(lambda: requests, session)
    for changes in ({"sigma": 0.1}, {"levels": 2}):
        session.editor.set_parameter(**changes)
        until(lambda: not session.work._coarse_meshes.busy)
        for _ in range(3):
            session.update()
            until(lambda: not session.work._coarse_meshes.busy)
    assert requests == [(SPHERE, 0), (SPHERE, 2)]
    off_the_screen = Session(SPHERE, "sphere", at_once=True)  # which prepares no meshes
    off_the_screen.editor.amend(channels=(PAIR,))
    for _ in range(2):
        off_the_screen.update()
        assert not off_the_screen.obstacle
    assert len(requests) == 2
    off_the_screen.close()


def test_warm_start_converts_fields_and_tau(session):
    session.editor.set_parameter(method="linearised", segments=3)
    linearised = matched(session).result.residual
    session.editor.set_parameter(method="nonlinear", tau=3.0)
    assert session.parameters.solver.segments == 0
    session.match(from_current_field=True)
    until(lambda: session.solver.finished, session)
    assert session.document.runs[-1].energies[0, 1] > 0
    assert session.result.residual < linearised


def test_run_follows_a_dragged_gaussian_at_once(endless):
    started = solving(endless).solver.started
    endless.match()
    assert endless.solver.started == started
    endless.dragging = True
    for alpha in (0.1, 0.2, 0.4):
        endless.editor.set_parameter("alpha", alpha=alpha)
        endless.update()
    assert endless.matching.problem.parameters.alpha == ENDLESS.alpha
    endless.dragging = False
    endless.update()
    assert endless.matching.problem.parameters.alpha == 0.4
    endless.dragging = True
    places = itertools.count()

    def drag():
        spec = f"gaussian:x={next(places) / 1000},y=1,z=0,width=0.15"
        endless.editor.set_spec("target", spec, "drag")

    until(lambda: drag() or len(endless.matching.record.restarts) > 1, endless)
    endless.dragging = False
    until(lambda: endless.matching.snapshot.problem == endless.work.problem, endless)
    endless.editor.seal()
    endless.undo()
    assert endless.active == PAIR


def test_result_for_a_replaced_mesh_is_unsaved(endless):
    solving(endless)
    endless.set_mesh(TORUS, "torus")
    end_run(endless)
    ready(endless)
    assert (endless.result, endless.document.runs, endless.solver.finished) == (None, (), False)
    [unsaved] = endless.saves.unsaved_documents
    assert unsaved.surface().mesh is SPHERE
    assert unsaved.result is not None
    assert not endless.notices.cards
    endless.undo()
    endless.update()
    assert endless.surface().mesh is SPHERE
    assert endless.result is None


def test_undo_does_not_close_a_mesh_during_its_match(session):
    session.set_mesh(TORUS, "torus")
    session.editor.set_parameter(**ENDLESS.to_dict())
    ready(session)
    solving(session)
    session.undo()
    session.undo()
    assert session.surface().mesh is TORUS
    check_message(session.notices.latest.text)
    end_run(session)
    assert session.notices.cards == ()
    found = session.result
    for _ in range(2):
        session.undo()
    assert session.surface().mesh is SPHERE
    assert session.saves.unsaved_documents[-1].result is found


def test_unknown_functions_do_not_end_a_run(endless):
    solver, matching = solving(endless).solver, endless.matching
    problem = matching.problem
    endless.editor.set_spec("source", "file:missing.npy")
    until(lambda: endless.work.error("source"), endless)
    assert (solver.running, matching.problem) == (True, problem)
    end_run(endless)
    assert not solver.failed, solver.reason


def test_failed_run_keeps_its_best_field(endless, monkeypatch):
    endless.editor.amend(parameters=ENDLESS.with_values(levels=1))
    solving(endless)
    monkeypatch.setattr(endless.matching, "_yield_to_next", lambda: 1 / 0)
    until(lambda: endless.solver.finished, endless)
    assert endless.solver.failed
    assert "ZeroDivisionError" in endless.notices.cards[0].text
    result = endless.result
    assert result.residual <= result.initial_residual
    np.testing.assert_allclose(result.advected, result.advect(result.parameters.tau), atol=1e-6)
    assert len(result.energy_history) == len(result.stages) > 1
    monkeypatch.undo()
    assert list(endless.notices.cards[0].remedies) == ["Continue", "Match again"]
    endless.notices.cards[0].remedies["Continue"]()
    assert endless.solver.running
    assert endless.notices.cards == ()


@pytest.fixture
def missed():
    """Return a session whose match has not reached its target."""
    session = matched(sessions.opened(BLIND, DISTANT_CHANNEL))
    yield session
    session.close()


def test_first_remedy_improves_the_match_in_one_step(missed):
    before, result = missed.document, missed.result
    assert result.verdict.kind == "not reached"
    first = result.verdict.remedies[0]
    missed.remedy(first)
    assert missed.solver.running
    assert missed.parameters == BLIND.with_values(**first.parameters)
    until(lambda: missed.solver.finished, missed)
    assert missed.result is not result
    assert missed.result.verdict.kind in ("matched", "nearly")
    assert missed.editor.undo_label == "reach further"
    missed.undo()
    assert missed.result is result
    assert missed.parameters == before.parameters
    missed.redo()
    assert missed.result.parameters.solver.reach == 1
    assert not missed.outdated
    missed.undo()
    missed.remedy(first)
    missed.editor.set_view("change the layout", layout="column")
    until(lambda: missed.solver.finished, missed)
    assert missed.editor.undo_label == "match"


def test_continue_starts_from_the_current_field(missed):
    history, remedy = missed.result.energy_history, missed.result.verdict.remedies[0]
    missed.remedy(Remedy("Continue", "resume the match", {}, True))
    until(lambda: missed.solver.finished, missed)
    assert missed.result.energy_history[0, 0] == pytest.approx(history[-1, 0], rel=0.1)
    assert history[:, 0].max() > 2 * history[-1, 0]
    assert missed.editor.undo_label == "match"
    missed.editor.amend(parameters=ENDLESS)
    missed.match()
    missed.remedy(remedy)
    assert missed.parameters == ENDLESS
    end_run(missed)
    assert missed.editor.undo_label == "match"  # the match is a step of its own


@pytest.fixture
def flowing(session):
    """Return a session that shows the flow after a match."""
    session.switch_flow_after_match()
    return session


def shows_flow(session):
    return session.view.arrows or session.view.streaks


def test_playing_waits_for_its_pictures(flowing, tmp_path):
    flowing.player.waiting = True
    matched(flowing)
    flowing.saves.record(flowing.document, Origin.of(tmp_path / "a.abfm"))
    flowing.update()
    assert flowing.time == 0
    flowing.player.waiting, flowing.player.speed = False, 4.0
    until(lambda: flowing.time > 0, flowing)
    until(lambda: not flowing.player.playing, flowing)
    assert not flowing.saves.unsaved
    assert flowing.editor.undo_label == "match"
    flowing.undo()
    assert not shows_flow(flowing)


def test_actions_of_the_user_stop_playing(flowing):
    matched(flowing)
    for do in (
        lambda: flowing.set_time(0.5),
        flowing.player.toggle,
        flowing.switch_flow_after_match,
        flowing.undo,
        flowing.match,
    ):
        flowing.player.play_once()
        do()
        assert not flowing.player.playing


def test_the_flow_of_a_cancelled_run_is_shown(endless):
    end_run(solving(endless))
    assert (endless.player.playing, endless.time) == (False, endless.parameters.tau)
    assert not shows_flow(endless)
    endless.switch_flow_after_match()
    end_run(solving(endless))
    assert endless.result.stop_reason == "cancelled"
    assert endless.player.playing


@pytest.fixture
def ball():
    """Yield a session whose ``view_of_flow`` returns the view after a match."""
    session = Session(SPHERE, "ball")

    def view_of_flow(velocity=1.0, **view):
        session.editor.amend(view=View(**view))
        match = SimpleNamespace(mesh=SPHERE, velocity=np.full((1, len(SPHERE.faces), 3), velocity))
        return session._run._view_of_flow(match)

    session.view_of_flow = view_of_flow
    yield session
    session.close()


@pytest.mark.parametrize("quickly", [False, True])
def test_quick_machines_show_streaks_on_small_meshes(ball, quickly):
    ball.draws_quickly = quickly
    view = ball.view_of_flow()
    assert (view.arrows, view.streaks) == (not quickly, quickly)


def test_view_after_a_match_keeps_choices_of_the_user(ball):
    assert ball.view_of_flow(velocity=0.0) is None  # there is no flow to show
    assert ball.view_of_flow(flow_after_match=False) is None
    for chosen in ({"streaks": True}, {"coloring": "speed"}):
        assert ball.view_of_flow(**chosen) is ball.view
        ball._run.shown_flow_of = None
    assert ball.view_of_flow().arrows
    assert ball.view_of_flow(arrows=True) is ball.view
    assert ball.view_of_flow() is ball.view
    for _ in range(2):
        ball.switch_flow_after_match()
    assert ball.view_of_flow().arrows

import threading

from abfm import TriangleMesh
from abfm.workers import progress
from abfm.workers.progress import step
from abfm_viewer.computing import evaluation
from abfm_viewer.computing.background import Latest
from abfm_viewer.session.loading import Load
from tests.viewer.sessions import SPHERE, opened, until


def test_job_reports_its_step_until_it_is_done():
    go_on, latest = threading.Event(), Latest()

    def job():
        with step("counting", about=" to ten"):
            go_on.wait(10)
        return 10

    latest.request(1, job)
    until(lambda: latest.overall.step)
    assert latest.overall.step.task == "counting to ten"
    go_on.set()
    until(lambda: not latest.busy)
    assert (latest.overall.step, latest.value) == (None, 10)
    latest.close()


def test_evaluation_reports_steps_from_its_subprocess(monkeypatch):
    monkeypatch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", 0)
    mesh = TriangleMesh(SPHERE.vertices, SPHERE.faces)  # a mesh without cached eigenfunctions
    functions = evaluation.Functions(mesh)
    steps = []
    with progress.reporting_steps(steps.append):
        functions.evaluate("eigenfunction:3")
    assert "computing eigenfunctions: 32" in [now.task for now in steps if now]
    assert steps[-1] is None
    functions.retire()


def test_background_computation_is_shown_with_its_step():
    session = opened()
    go_on = threading.Event()

    def read():
        with step("reading .off", None):
            go_on.wait(10)
        return lambda: None

    session.loading.begin(Load("opening a file", read))
    until(lambda: session.loading.step, session)
    assert session.busy == "opening: reading .off"
    go_on.set()
    until(lambda: not session.busy, session)
    session.close()

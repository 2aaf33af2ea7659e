"""Many problems on an executor: as one after the other, in their order, and stopped when asked."""

import multiprocessing
import os
import signal
import tempfile
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm import Monitor, ParameterError, Parameters, Problem, match, solve_many
from abfm.matching.solve_many import _meshes, _Task
from abfm.parameters import PAPER
from tests.core.fields import bump
from tests.messages import raises
from tests.shapes import icosphere

SPHERE, OTHER = icosphere(2), icosphere(2, 1.1)
QUICK = Parameters.of(iterations=5)
ENDLESS = Parameters.of(
    **PAPER, iterations=100_000, max_displacement=1e-3, tolerance=0, cooling_stages=1
)


def problem(index, parameters=QUICK, mesh=SPHERE):
    f, g = (bump(mesh, mesh.vertices[vertex], 0.4) for vertex in (index, index + 30))
    return Problem(mesh, f, g, parameters)


@pytest.fixture(scope="module", params=["threads", "processes"])
def executor(request):
    spawning = multiprocessing.get_context("spawn")
    threads = request.param == "threads"
    with ThreadPoolExecutor(2) if threads else ProcessPoolExecutor(2, spawning) as made:
        yield made


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where temporary files are; none is left."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield tmp_path
    assert list(tmp_path.iterdir()) == []


def test_matches_are_those_of_match_in_the_order_of_the_problems_with_their_meshes(executor):
    problems = [problem(index, mesh=SPHERE if index % 2 else OTHER) for index in range(6)]
    found = list(solve_many(iter(problems), executor))
    for one, of in zip(found, problems, strict=True):
        assert one.mesh is of.mesh
        assert_array_equal(one.velocity, match(of).velocity)
    assert list(solve_many([], executor)) == []


def test_all_tell_what_they_have_come_to_and_end_with_their_best_when_stopped(executor):
    monitor = Monitor()
    matches = solve_many([problem(index, ENDLESS) for index in range(4)], executor, monitor=monitor)

    def stop():
        end = time.monotonic() + 60
        while not {0, 1} <= {k for k, told in monitor.reports.items() if told.iteration > 3}:
            assert time.monotonic() < end
            time.sleep(0.01)
        monitor.stop()

    stopping = threading.Thread(target=stop)
    stopping.start()
    found = list(matches)
    stopping.join()
    assert 2 <= len(found) < 4  # those that had not begun are left out
    for one in found:
        assert one.stop_reason == "cancelled"
        assert one.energy_history[-1, 0] < one.energy_history[0, 0]


def test_problems_under_way_stop_when_no_more_are_asked_for(executor):
    matches = solve_many([problem(0), problem(1, ENDLESS), problem(2, ENDLESS)], executor)
    next(matches)
    matches.close()
    assert executor.submit(os.getpid).result(60)  # the next in the queue gets its turn


def test_an_error_comes_in_the_place_of_its_problem(executor):
    wild = np.full((1, len(SPHERE.faces), 3), 1e12)
    matches = solve_many([problem(0), problem(1).starting_from(wild), problem(2)], executor)
    next(matches)
    with raises(ParameterError):
        next(matches)


class Elsewhere(Executor):
    """Runs a task as in another process, which may see a folder in place of this one's."""

    def __init__(self, folder=None):
        self.folder, self.sizes = folder, []
        _meshes._kept.clear()

    def submit(self, function, task, /):
        future = Future()
        _meshes.here.clear()
        self.sizes.append(sum(map(len, task.parcel.values.values())))
        future.set_result(function(task._replace(folder=self.folder or task.folder)))
        return future


def test_who_does_not_see_the_files_gets_the_mesh_with_the_problem(folder):
    elsewhere = Elsewhere(folder / "not here")
    [found] = solve_many([problem(0)], elsewhere)
    assert_array_equal(found.velocity, match(problem(0)).velocity)
    assert elsewhere.sizes[0] == 0 < elsewhere.sizes[1]


def test_a_process_reads_a_mesh_once(monkeypatch):
    read, usual = [], _Task.mesh
    monkeypatch.setattr(_Task, "mesh", lambda *given: read.append(given) or usual(*given))
    assert len(list(solve_many([problem(index) for index in range(3)], Elsewhere()))) == 3
    assert len(read) == 1


def test_a_process_that_is_killed_is_told():
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as processes:
        pid = processes.submit(os.getpid).result()
        monitor = Monitor(lambda report: os.kill(pid, signal.SIGKILL))
        with pytest.raises(BrokenProcessPool):
            list(solve_many([problem(0, ENDLESS)], processes, monitor=monitor))

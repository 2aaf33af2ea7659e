"""Matches on executors: order, equality with `match`, errors and cancelling."""

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm import ParameterError, Parameters, Problem, match, solve_many
from abfm.parameters import PAPER
from abfm.workers.executor import Processes
from tests.core.fields import bump
from tests.messages import raises
from tests.shapes import icosphere

solve_many_module = sys.modules["abfm.matching.solve_many"]
SPHERE, LARGER_SPHERE = icosphere(2), icosphere(2, 1.1)
SHORT_RUN = Parameters.of(iterations=5)
ENDLESS_RUN = Parameters.of(
    **PAPER, iterations=100_000, max_displacement=1e-3, tolerance=0, cooling_stages=1
)


def problem(index, parameters=SHORT_RUN, mesh=SPHERE):
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
    """Set the folder of temporary files, and check that none remains."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield tmp_path
    assert list(tmp_path.iterdir()) == []


def test_matches_are_in_the_order_of_the_problems(executor):
    problems = [problem(index, mesh=SPHERE if index % 2 else LARGER_SPHERE) for index in range(6)]
    found = list(solve_many(iter(problems), executor))
    for one, of in zip(found, problems, strict=True):
        assert one.mesh is of.mesh
        assert_array_equal(one.velocity, match(of).velocity)
    assert list(solve_many([], executor)) == []


def test_closing_the_iterator_stops_running_matches(executor):
    matches = solve_many([problem(0), problem(1, ENDLESS_RUN), problem(2, ENDLESS_RUN)], executor)
    next(matches)
    matches.close()
    assert executor.submit(os.getpid).result(60)  # the worker is free for another call


def test_match_started_during_closing_stops():
    """A match that begins while the iterator closes stops, as its marker file was deleted."""
    with ThreadPoolExecutor(1) as executor:
        matches = solve_many([problem(0), problem(1, ENDLESS_RUN)], executor)
        next(matches)
        matches.close()
        assert executor.submit(os.getpid).result(20)


def test_error_is_raised_for_its_problem(executor):
    wild = np.full((1, len(SPHERE.faces), 3), 1e12)
    matches = solve_many([problem(0), problem(1).starting_from(wild), problem(2)], executor)
    next(matches)
    with raises(ParameterError):
        next(matches)


class RemoteExecutor(Executor):
    """An executor that runs tasks as on another machine, without access to local files."""

    def submit(self, function, task, /):
        future = Future()
        future.set_result(function(task._replace(marker=Path("/nowhere"))))
        return future


def test_remote_machines_need_no_files_and_cache_meshes():
    solve_many_module._mesh.cache_clear()
    problems = [problem(index) for index in range(3)]
    found = list(solve_many(problems, RemoteExecutor()))
    assert_array_equal(found[0].velocity, match(problems[0]).velocity)
    assert solve_many_module._mesh.cache_info().misses == 1


def test_local_processes_give_the_same_match():
    processes = Processes(2)
    (found,) = solve_many([problem(0)], processes)
    processes.shutdown()
    assert_array_equal(found.velocity, match(problem(0)).velocity)


def test_killed_process_raises_an_error():
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as processes:
        pid = processes.submit(os.getpid).result()
        killing = threading.Timer(1, os.kill, (pid, signal.SIGKILL))
        killing.start()
        with pytest.raises(BrokenProcessPool):
            list(solve_many([problem(0, ENDLESS_RUN)], processes))
        killing.join()

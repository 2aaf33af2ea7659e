"""Rows on Dask: equal result files for any choice of workers, and lost connections."""

import gc
import json
import threading
from importlib.metadata import PackageNotFoundError, version
from unittest.mock import Mock

import pytest
from distributed import Client, LocalCluster

import abfm
from abfm.batch import Cluster, Workers, dask_connection, run
from abfm.batch.cluster import CONNECTING, NO_WORKERS, ConnectionLostError
from abfm.batch.run import ENDED_MESSAGE
from abfm.errors import AbfmError, ResultError
from abfm.workers.progress import reporting_steps
from tests.core.batch.rows import ONE, Deadly, pair, results
from tests.messages import check_message, raises
from tests.processes import children

ROWS = [pair(target=target) for target in (9, 12, 15, 18)]


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Return the results of a run with one process, to compare with."""
    folder = tmp_path_factory.mktemp("alone")
    run(ROWS, folder, ONE)
    return results(folder)


@pytest.fixture
def elsewhere():
    """Yield a cluster whose only worker is a thread of this process."""
    options = {"processes": False, "n_workers": 1, "threads_per_worker": 1}
    with LocalCluster(**options, dashboard_address="127.0.0.1:0", silence_logs=60) as cluster:
        yield cluster


def test_two_processes_give_equal_files(alone, tmp_path, capfd):
    deadly = Deadly("deadly", pair(target=30).options)
    lost, before = pair("lost", mesh="nowhere.off"), children()
    rows = [*ROWS[:2], lost, deadly, *ROWS[2:]]
    entries = run(rows, tmp_path, Cluster(jobs=2))
    by_name = {entry.row.name: entry for entry in entries if entry.state != "done"}
    assert by_name.keys() == {"deadly", "lost"}
    assert (by_name["deadly"].reason, by_name["deadly"].record.tries) == (ENDED_MESSAGE, 3)
    assert {entry.record.tries for entry in entries if entry.row is not deadly} == {1}
    assert results(tmp_path) == alone
    assert not list(tmp_path.rglob(".abfm-*"))
    assert children() == before
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("is_accessible", [True, False])
def test_cluster_writes_or_sends_results(is_accessible, alone, elsewhere, tmp_path, monkeypatch):
    """Workers write to a folder they can access; otherwise they send results to the client."""
    (tmp_path / "scheduler.json").write_text(json.dumps(elsewhere.scheduler.identity()))
    cluster = Cluster(scheduler_file=tmp_path / "scheduler.json")
    if not is_accessible:
        # first without access to the folder, then also without access to the input files
        monkeypatch.setattr("abfm.batch.attempt.Ledger.is_accessible", lambda *_: False)
        monkeypatch.setattr("abfm.batch.attempt.all", lambda _: False, raising=False)
    entries = run([*ROWS, pair("lost", mesh="nowhere.off")], tmp_path / "out", cluster)
    assert [entry.state for entry in entries] == ["done"] * 4 + ["failed"]
    check_message(entries[-1].reason)
    assert results(tmp_path / "out") == alone


def test_connection_persists_between_runs(alone, elsewhere, tmp_path, monkeypatch):
    made, usual = [], dask_connection._client
    monkeypatch.setattr(dask_connection, "_client", lambda *x: made.append(usual(*x)) or made[-1])
    with Workers(Cluster(scheduler=elsewhere.scheduler_address)) as workers:
        for rows in (ROWS[:2], ROWS):
            entries = workers.run(rows, tmp_path)
            assert [entry.state for entry in entries] == ["done"] * len(rows)
        assert results(tmp_path) == alone
        assert len(made) == 1
        made[0].close()  # as if the connection to the scheduler was lost
        (entry,) = workers.run([pair("one more", 4, 11)], tmp_path)
        assert entry.state == "done"
    assert [client.status for client in made] == ["closed", "closed"]


def test_lost_scheduler_reports_unfinished_rows(elsewhere, tmp_path, capfd):
    cluster = Cluster(scheduler=elsewhere.scheduler_address)
    with raises(ConnectionLostError, 3):
        run(ROWS, tmp_path, cluster, on_change=lambda entry: elsewhere.close())
    assert len(results(tmp_path)) >= 1
    assert capfd.readouterr() == ("", "")


def test_cancelled_cluster_run_keeps_finished_rows(elsewhere, tmp_path):
    control = abfm.workers.Control()
    cluster = Cluster(scheduler=elsewhere.scheduler_address)
    many = [pair(target=target) for target in range(20, 60)]
    entries = run(many, tmp_path, cluster, control=control, on_change=lambda _: control.cancel())
    states = [entry.state for entry in entries]
    assert states[0] == "done"
    assert states[-1] == "missing"


def test_missing_scheduler_is_refused(tmp_path):
    with raises(ResultError):
        run(ROWS, tmp_path, Cluster(scheduler_file=tmp_path / "none.json"))
    with raises(ResultError, "scheduler", "nonsense"):
        run(ROWS, tmp_path, Cluster(scheduler="nonsense://1"))
    clients = [each for each in gc.get_objects() if type(each) is Client]
    assert {each.status for each in clients} <= {"closed"}  # otherwise Dask may deadlock
    # another service answers
    refuse = Mock(side_effect=MemoryError("out of memory"))
    with raises(ResultError, "tcp://1"):
        dask_connection._client(refuse, "tcp://1", abfm.workers.Control())


def test_connecting_can_be_cancelled(tmp_path, monkeypatch):
    control, waited, closed = abfm.workers.Control(), threading.Event(), threading.Event()

    def connect(*given, **named):
        control.cancel()
        waited.wait()
        return Mock(close=closed.set)

    monkeypatch.setattr("distributed.Client", connect)
    entries = run(ROWS, tmp_path, Cluster(scheduler="tcp://1"), control=control)
    assert [entry.state for entry in entries] == ["missing"] * len(ROWS)
    waited.set()
    assert closed.wait(10)  # the late connection is closed


@pytest.mark.parametrize("text", ["", "{}", "[]", "nonsense", '{"address": 5}', '{"address": ""}'])
def test_scheduler_file_without_address_is_refused(text, tmp_path):
    (tmp_path / "scheduler.json").write_text(text)
    with raises(ResultError, "scheduler.json"):
        run(ROWS, tmp_path / "out", Cluster(scheduler_file=tmp_path / "scheduler.json"))


def test_unreadable_scheduler_file_is_refused(tmp_path, monkeypatch):
    (tmp_path / "scheduler.json").touch()
    refuse = Mock(side_effect=PermissionError(13, "Permission denied"))
    monkeypatch.setattr(dask_connection, "read_bytes", refuse)
    with raises(ResultError, "scheduler.json"):
        run(ROWS, tmp_path / "out", Cluster(scheduler_file=tmp_path / "scheduler.json"))


def test_waiting_for_workers_is_reported(alone, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_connection, "_COUNT_SECONDS", 0.2)
    steps = []

    def note(step):
        if threading.current_thread() is threading.main_thread():  # other threads are workers
            steps.append(step and step.task)
            if steps[-1] == NO_WORKERS:
                cluster.scale(1)

    options = {"processes": False, "n_workers": 0, "threads_per_worker": 1}
    with (
        LocalCluster(**options, dashboard_address="127.0.0.1:0", silence_logs=60) as cluster,
        reporting_steps(note),
    ):
        run(ROWS, tmp_path, Cluster(scheduler=cluster.scheduler_address))
    assert steps == [CONNECTING, None, NO_WORKERS, None]
    assert results(tmp_path) == alone


def test_cluster_with_another_version_is_refused(elsewhere, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_connection, "installed_version", lambda: "9.9")
    with raises(ResultError, "scheduler", version("abfm"), "9.9"):
        run(ROWS, tmp_path, Cluster(scheduler=elsewhere.scheduler_address))


def test_cluster_without_abfm_is_refused():
    none = PackageNotFoundError("abfm")
    with raises(ResultError):
        dask_connection._check_versions(Mock(run_on_scheduler=Mock(side_effect=none)))
    there = {"tcp://1": version("abfm"), "tcp://2": OSError("gone meanwhile"), "tcp://3": none}
    client = Mock(run_on_scheduler=Mock(return_value=version("abfm")))
    client.run.return_value = there
    with raises(ResultError, "tcp://3"):
        dask_connection._check_versions(client)
    del there["tcp://3"]
    dask_connection._check_versions(client)


def test_missing_dask_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_connection, "find_spec", lambda name: None)
    with raises(AbfmError, "abfm[cluster]"):
        run(ROWS, tmp_path, Cluster(scheduler="tcp://1"))

"""Runs of batches: rows are solved once, fail independently, and resume after interruptions."""

import json
import sys
from concurrent.futures import Future
from dataclasses import asdict, replace

import numpy as np
import pytest

import abfm
from abfm.batch import Cluster, Cost, Ledger, Row, Workers, run
from abfm.batch.attempt import IMPOSSIBLE_STEP, WorkItem, attempt
from abfm.batch.run import ENDED_MESSAGE, with_contents
from abfm.errors import AbfmWarning, ParameterError, ResultError
from abfm.flow.exponential import counted_row_products
from abfm.io.atomic import temporary_file
from abfm.matching import task
from abfm.outcome import Outcome
from abfm.tasks import Monitor
from abfm.workers.progress import reporting_steps
from abfm.workers.worker import WorkerEndedError
from tests.core.batch.rows import BRIEF, ONE, Mortal, Quick, Warned, pair, results
from tests.mesh_writers import off_file
from tests.messages import check_message, raises
from tests.shapes import icosphere
from tests.spare_processes import reused_processes

QUICK = Quick("quick", pair().options)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_worker_with_another_version_solves_nothing(tmp_path):
    ledger = Ledger(tmp_path)
    task = WorkItem(QUICK, str(ledger.folder), ledger.make(), version="0.0.9")
    check_message(attempt(task).record.reason, "0.0.9")
    assert not results(tmp_path)


def test_worker_without_write_access_sends_its_result(tmp_path, monkeypatch):
    ledger = Ledger(tmp_path)
    task = WorkItem(QUICK, str(ledger.folder), ledger.make())
    with monkeypatch.context() as patched:
        patched.setattr(
            "abfm.batch.ledger.os.access", lambda path, mode: path != ledger.records_folder
        )
        answer = attempt(task)
    assert answer.result
    assert not results(tmp_path)
    assert attempt(task).result is None
    assert results(tmp_path) == {f"{answer.record.digest}.npz": answer.result}


def test_equal_warnings_are_reported_once(spare_process, tmp_path):
    rows = [Warned(f"row {number}", pair(source=number).options) for number in (1, 2)]
    with pytest.warns(AbfmWarning, match="row 1: no value") as caught:
        entries = run(rows, tmp_path, ONE)
    assert len(caught) == 1
    assert [entry.record.warning for entry in entries] == ["no value"] * 2
    assert [entry.record.warning for entry in Ledger(tmp_path).entries(rows)] == ["no value"] * 2


def test_products_are_unknown_in_a_shared_process(tmp_path):
    """The count of operator products is None if another row is solved at the same time."""
    folders = [tmp_path / name for name in ("beside", "alone")]
    shared, alone = (WorkItem(QUICK, str(folder), Ledger(folder).make()) for folder in folders)
    with counted_row_products():
        assert attempt(shared).record.row_products is None
    assert attempt(alone).record.row_products == 0


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Solve rows once; return rows, folder, entries, and the entries passed to ``on_change``."""
    folder, changed = tmp_path_factory.mktemp("done"), []
    off_file(folder / "ball.off", ball := icosphere(2))
    np.save(folder / "z.npy", ball.vertices[:, 2])
    (folder / "broken.off").write_text("OFF\n3 1 0\n0 0 0\n")
    sphere = {"a": "ball.off", "b": "ball.off", "source": "coordinate:x", "target": "coordinate:y"}
    rows = [
        pair("first"),
        pair("lost", mesh="nowhere.off"),
        Row("broken", dict(pair().options) | {"mesh": "broken.off"}, folder),
        pair("second", 3, 12),
        Row("both", sphere | BRIEF, folder),
        pair("far", target=100_000),
        pair("again"),
        Row(
            "own",
            {"mesh": "ball.off", "source": "file:z.npy", "target": "coordinate:x"} | BRIEF,
            folder,
        ),
    ]
    with reused_processes():
        entries = run(rows, folder / "out", ONE, on_change=changed.append)
    return rows, folder / "out", entries, changed


def test_failed_rows_do_not_stop_others(done):
    rows, _, entries, changed = done
    assert [entry.row for entry in entries] == rows
    states = {entry.row.name: entry.state for entry in entries}
    failed = {"lost", "broken", "far"}
    assert states == {name: "failed" if name in failed else "done" for name in states}
    reasons = {entry.row.name: entry.reason for entry in entries}
    check_message(reasons["lost"], "nowhere.off")
    assert "broken.off" in reasons["broken"]
    check_message(reasons["far"], 100000)
    assert not any(reasons[name] for name in states.keys() - failed)
    assert len(changed) == len(rows) - 1  # the two equal rows are solved once
    by_name = {entry.row.name: entry for entry in entries}
    assert by_name["again"].path == by_name["first"].path
    with raises(ResultError, "far"):
        by_name["far"].load()


def test_processes_persist_between_runs(tmp_path, monkeypatch):
    made, module = [], sys.modules["abfm.workers.executor"]
    usual, control = module.Worker, abfm.workers.Control()

    def make(*given):
        made.append(usual(*given))
        return made[-1]

    monkeypatch.setattr(module, "Worker", make)
    with Workers(ONE) as workers:
        (first,) = workers.run([pair("first")], tmp_path)
        assert workers.run([pair("first")], tmp_path) == [first]
        workers.run([pair("second", 3, 12)], tmp_path / "other")
        assert len(made) == 1
        rows = [pair("third", 5, 13), pair("fourth", 6, 14)]
        entries = workers.run(rows, tmp_path, control=control, on_change=lambda _: control.cancel())
        assert [entry.state for entry in entries] == ["done", "missing"]
        assert [entry.state for entry in workers.run(rows, tmp_path)] == ["done", "done"]
    assert len(made) == 2
    for worker in made:
        with pytest.raises(WorkerEndedError):
            worker.call(print)


def test_process_is_replaced_after_an_error(tmp_path, monkeypatch):
    made, control = [], abfm.workers.Control()

    class Here:
        """A worker in this process, which does not answer after it is closed."""

        def __init__(self, *given):
            self.is_closed = False
            made.append(self)

        def call(self, function, *arguments):
            if self.is_closed:
                raise WorkerEndedError
            answer = Future()
            answer.set_result(function(None, *arguments))
            return answer

        def close(self):
            self.is_closed = True

    def refuse(entry):
        control.cancel()
        raise OSError("no space left")

    monkeypatch.setattr("abfm.workers.executor.Worker", Here)
    with Workers(ONE) as workers:
        with raises(OSError, "no space left"):
            rows = [pair("first"), pair("third", 5, 13)]
            workers.run(rows, tmp_path, on_change=refuse, control=control)
        (entry,) = workers.run([pair("second", 3, 12)], tmp_path)
    assert entry.state == "done"
    assert [each.is_closed for each in made] == [True, True]


def test_results_equal_direct_solutions(done, tmp_path):
    by_name = {entry.row.name: entry for entry in done[2]}
    match = by_name["first"].load()
    assert by_name["first"].path.name == f"{match.problem.digest}.npz"
    assert match.problem.specs[0] == ("gaussian:vertex=0,width=0.3",)
    abfm.match(match.problem).save(tmp_path / "alone.npz")
    assert by_name["first"].path.read_bytes() == (tmp_path / "alone.npz").read_bytes()
    own = by_name["own"].load()
    assert own.problem.specs[0] == ("file:z.npy",)
    facts = by_name["first"].facts
    assert (facts.outcome, facts.reason) == (match.verdict.kind, match.verdict.reason)
    assert facts.worse_residual == match.worse_residual
    for name in ("folded", "log2_area", "log2_area_95"):
        assert facts.numbers[name] == match.facts.numbers[name]
    assert (facts.tone, facts.warnings) == (match.facts.tone, match.facts.warnings)


def test_cost_of_a_row_is_recorded(done):
    by_name = {entry.row.name: entry for entry in done[2]}
    match, cost = by_name["first"].load(), by_name["first"].record
    assert cost.evaluations > len(match.energy_history) - 1
    assert cost.row_products > cost.evaluations * len(match.mesh.vertices)
    assert cost.row_products % len(match.mesh.vertices) == 0
    written = json.loads((done[1] / "ledger" / f"{by_name['first'].row.key}.json").read_text())
    assert written == asdict(cost)
    assert (cost.digest, cost.reason, cost.tries) == (match.problem.digest, "", 1)
    assert 0 < cost.seconds < 1e9
    assert by_name["both"].record.evaluations > 0
    assert by_name["far"].record.evaluations is None
    assert match.residual > match.parameters.goal
    assert cost.seconds_to_goal is None
    easy = Cost()
    near = pair(target=1, goal=1).task()
    near.solve(Monitor(on_partial=easy.watch(near.goal)))
    assert easy.seconds_to_goal > 0


def test_registration_row_equals_register(done, tmp_path):
    entry = next(entry for entry in done[2] if entry.row.name == "both")
    assert entry.digest == entry.row.key
    assert isinstance(entry.load(), abfm.Registration)
    values = entry.row.values()
    a, b = abfm.load_mesh(values["a"]), abfm.load_mesh(values["b"])
    parameters = abfm.Parameters.of(refine=0, iterations=4, levels=1, cooling_stages=2)
    found = abfm.register(a, b, values["source"], values["target"], parameters=parameters)
    found.save(tmp_path / "alone.npz")
    assert entry.path.read_bytes() == (tmp_path / "alone.npz").read_bytes()


def test_only_missing_results_are_solved_again(done, spare_process):
    _, folder, entries, _ = done
    good = [entry.row for entry in entries if entry.state == "done"]
    before = files(folder)

    def refuse(entry):
        raise AssertionError(f"{entry.row.name} is solved again")

    # nothing is missing, so no connection is opened to this nonexistent scheduler
    again = run(good, folder, Cluster(scheduler="tcp://127.0.0.1:9"), on_change=refuse)
    assert again == [entry for entry in entries if entry.state == "done"]
    assert files(folder) == before
    lost = entries[3]
    content, changed = lost.path.read_bytes(), []
    lost.path.unlink()
    assert Ledger(folder).entry(lost.row).state == "missing"
    for part in (b"", content[:-300]):  # as after an interrupted copy
        lost.path.write_bytes(part)
        assert Ledger(folder).entry(lost.row).state == "missing"
    run(good, folder, ONE, on_change=lambda entry: changed.append(entry.row.name))
    assert changed == ["second"]
    assert lost.path.read_bytes() == content


def test_damaged_record_keeps_the_result(done, spare_process):
    _, folder, entries, _ = done
    ledger, (row, path) = Ledger(folder), (entries[0].row, entries[0].path)
    record, result = folder / "ledger" / f"{row.key}.json", path.stat().st_mtime_ns
    for damage in ("", "[]", "{}", '{"digest": 1}', '{"digest": "x", "other": 1}', '{"digest"'):
        record.write_text(damage)
        assert ledger.entry(row).state == "missing"
        check_message(ledger.entry(row).reason, "ledger")
    (entry,) = run([row], folder, ONE)
    assert (entry.state, entry.path) == ("done", path)
    assert path.stat().st_mtime_ns == result  # the existing result was not solved again


@pytest.mark.parametrize(
    "fields",
    [
        *({"seconds": value} for value in ("abc", {}, float("inf"), float("nan"), -1)),
        {"evaluations": "many"},
        {"tries": None},
        {"reason": 3},
        {"digest": "../x"},
        {"digest": "/tmp/y"},
    ],
)
def test_record_with_wrong_field_is_missing(done, tmp_path, fields):
    """A record with an invalid field is ignored, so it cannot refer to files elsewhere."""
    row, ledger = done[0][0], Ledger(tmp_path)
    ledger.make()
    place = ledger.records_folder / f"{row.key}.json"
    place.write_text(json.dumps({"digest": "ab", **fields}))
    assert ledger.entry(row).state == "missing"
    place.write_text(json.dumps({"digest": "ab", "reason": "no \x1b[31mfile"}))
    assert ledger.entry(row).reason == "no ?[31mfile"


@pytest.mark.parametrize(
    "damage",
    [
        *({"key": key} for key in ("../x", "/x/y", "", 3, None)),
        *({"options": options} for options in (3, [3], [["mesh", {}]], [["no", "such"]])),
        {"name": 3},
        {"folder": None},
    ],
)
def test_damaged_row_does_not_hide_others(done, damage):
    (row, *_), folder, _, _ = done
    ledger = Ledger(folder)
    good = {**row.to_dict(), "key": row.key}
    rows = [{**good, **damage}, 0.5, good]
    (ledger.records_folder / "rows.json").write_text(
        json.dumps({"title": "a\x1b[31mt", "rows": rows})
    )
    title, entries = ledger.read_rows()
    assert title == "a?[31mt"
    assert [entry.state for entry in entries] == ["failed", "failed", ledger.entry(row).state]
    assert [entry.row.name for entry in entries[:2]] == ["row 1", "row 2"]
    check_message(entries[1].reason, 0.5)
    assert entries[2].row == row


@pytest.mark.parametrize(
    "damage",
    [
        {"verdict": ["splendid", "none", "why", ""]},
        {"verdict": ["matched", "no cause", "why", ""]},
        {"verdict": ["matched"]},
        {"residual": np.inf},
        {"residual": np.nan},
        {"residual": -0.5},
        {"verified_residual": "low"},
        {"path_step": 99},
        {"warnings": [1, 2]},
        {"warnings": ["\x1b[31mred"]},
    ],
)
def test_damaged_result_is_a_failed_row(done, tmp_path, damage):
    entry = next(entry for entry in done[2] if entry.row.name == "first")
    with np.load(entry.path) as file:
        arrays = dict(file)
    np.savez(tmp_path / "damaged.npz", **(arrays | damage))
    facts = replace(entry, path=tmp_path / "damaged.npz").facts
    assert (facts.outcome, facts.numbers) == (Outcome.FAILED, {})
    assert "damaged.npz" in facts.reason


def test_impossible_row_is_reported_before_it_is_solved(tmp_path, monkeypatch):
    row, ledger, seen = pair(target=5, source=4), Ledger(tmp_path), []
    impossible = Row("sub-01", dict(row.options) | {"source": "expression:1"})
    solve = task.match

    def solving(*given, **named):
        seen.append(ledger.entry(impossible))
        return solve(*given, **named)

    monkeypatch.setattr(task, "match", solving)
    steps = []
    with reporting_steps(lambda step: steps.append(step and step.task)):
        attempt(WorkItem(impossible, str(tmp_path), ledger.make()))
        attempt(WorkItem(row, str(tmp_path), ledger.make()))
    (before, _), after = seen, ledger.entry(impossible)
    assert (before.state, before.facts.outcome) == ("missing", Outcome.MISSING)
    check_message(before.facts.reason, "source")
    assert after.facts.outcome is Outcome.IMPOSSIBLE
    [reported] = {each for each in steps if each and each.startswith(IMPOSSIBLE_STEP)}
    assert "sub-01" in reported


def test_stored_rows_are_read(done):
    rows, folder, _, _ = done
    ledger = Ledger(folder)
    ledger.write_rows(rows, "a title")
    assert ledger.read_rows() == ("a title", [ledger.entry(row) for row in rows])
    for damage in ("3", '{"title": "no rows"}', "["):
        (folder / "ledger" / "rows.json").write_text(damage)
        with raises(ResultError):
            ledger.read_rows()
    with raises(ResultError):
        Ledger(folder / "nothing").read_rows()


def test_row_is_retried_after_its_process_died(tmp_path):
    mortal = Mortal("mortal", pair(target=20).options, tmp_path / "tried")
    entries = run([mortal, pair(target=12)], tmp_path / "out", ONE)
    assert [(entry.state, entry.record.tries) for entry in entries] == [("done", 2), ("done", 1)]
    assert not list((tmp_path / "out").rglob(".abfm-*"))


def test_row_is_attempted_at_most_three_times(tmp_path, monkeypatch):
    tried = []

    def call(worker, function, call):
        tried.append(call.args[0].row.name)
        raise WorkerEndedError

    monkeypatch.setattr("abfm.workers.worker.Worker.call", call)
    entries = run([pair("one"), pair("two", target=12)], tmp_path, ONE)
    assert sorted(tried) == ["one"] * 3 + ["two"] * 3
    assert [(entry.reason, entry.record.tries) for entry in entries] == [(ENDED_MESSAGE, 3)] * 2


def test_cancelled_run_keeps_finished_rows(tmp_path):
    control = abfm.workers.Control()
    rows = [pair(target=target) for target in (9, 12, 15)]
    with temporary_file(tmp_path, ".json") as temporary:
        abandoned = tmp_path / "ledger" / temporary.name

    def cancel(entry):
        abandoned.touch()  # as if a process was killed while writing
        control.cancel()

    entries = run(rows, tmp_path, ONE, control=control, on_change=cancel)
    assert not abandoned.exists()
    assert [entry.state for entry in entries] == ["done", "missing", "missing"]
    assert run(rows, tmp_path, ONE, control=control) == entries
    assert len(results(tmp_path)) == 1


def test_worker_sends_results_and_requests_files(done, tmp_path):
    _, folder, entries, _ = done
    entry = next(entry for entry in entries if entry.row.name == "own")
    unseen = WorkItem(entry.row, str(folder), "another one")
    answer = attempt(unseen)
    assert answer.record.digest == entry.digest
    assert answer.result == entry.path.read_bytes()
    paths = [folder.parent / name for name in ("ball.off", "z.npy")]
    with_files, moved = with_contents(unseen), [path.rename(tmp_path / path.name) for path in paths]
    try:
        assert attempt(unseen).needs_contents
        sent = attempt(with_files)
    finally:
        for path, before in zip(moved, paths, strict=True):
            path.rename(before)
    assert (sent.record.digest, sent.result) == (entry.digest, answer.result)
    both = next(entry for entry in entries if entry.row.name == "both")
    sent = attempt(with_contents(WorkItem(both.row, "/nowhere", "")))
    assert (sent.record.digest, sent.result) == (both.digest, both.path.read_bytes())


def test_exception_of_a_row_is_its_reason(monkeypatch, tmp_path):
    def fail(row):
        raise KeyError("two\nlines")

    monkeypatch.setattr(Row, "task", fail)
    record = attempt(WorkItem(pair(), str(tmp_path), "")).record
    assert record.reason == "KeyError: 'two\\nlines'"


def test_cluster_needs_one_valid_choice():
    with raises(ParameterError):
        Cluster(jobs=2, scheduler="tcp://1.2.3.4:5")
    for jobs in (0, -1, 2.5, 10_000):
        with raises(ParameterError):
            Cluster(jobs=jobs)
    assert Cluster().processes >= 1


def test_unwritable_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with raises(ResultError):
        run([pair()], tmp_path / "file" / "out")

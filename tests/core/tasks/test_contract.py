"""Properties that every type of task has; the same tests run for all types."""

import json
import pickle
import shutil

import numpy as np
import pytest

import abfm
from abfm.batch import KINDS, Cluster, run
from abfm.batch.table import known_columns
from abfm.errors import AbfmError, ParameterError
from abfm.loading import task_of
from abfm.outcome import Outcome
from abfm.population.task import PopulationTask
from abfm.sequences.task import SequenceTask
from abfm.workers.control import CancelledError
from tests.core.tasks.cases import CASES, Case
from tests.messages import raises
from tests.spare_processes import reused_processes


@pytest.fixture(scope="module", autouse=True)
def _batches_reuse_one_process():
    with reused_processes():
        yield


@pytest.fixture(scope="module", params=CASES, ids=lambda kind: kind.kind)
def case(request, tmp_path_factory):
    return Case(request.param, tmp_path_factory.mktemp(request.param.kind))


@pytest.fixture
def saved(case, tmp_path):
    case.found.save(tmp_path / "result.npz")
    return tmp_path / "result.npz"


def arrays_of(path):
    with np.load(path) as file:
        return dict(file)


def assert_same_arrays(one, other):
    assert one.keys() == other.keys()
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)


def test_inputs_have_help_and_unique_names(case):
    inputs = case.kind.inputs
    names = [each.name for each in inputs]
    assert all(each.help for each in inputs)
    assert len(set(names)) == len(names)
    assert set(case.kind.needs) <= set(names)
    assert {each.name for each in inputs if each.is_argument} <= {*case.kind.needs, "mesh"}
    assert case.kind.kind not in KINDS or set(names) <= known_columns().keys()


def test_missing_unknown_and_invalid_inputs_are_refused(case):
    for name in case.kind.needs:
        with raises(ParameterError, name):
            case.row(**{name: None})
    with raises(ParameterError, "alpa", "alpha"):
        case.row(alpa=1)
    for value in (-1, "much"):
        with raises(ParameterError, "alpha"):
            case.row(alpha=value)
    assert case.row(mask=" ").key == case.row().key  # an empty cell counts as absent


def test_missing_files_are_refused(case):
    for each in case.kind.inputs:
        if each.name in case.kind.needs:
            with pytest.raises(AbfmError, match="nowhere"):
                case.task(**{each.name: "nowhere.ply"}).solve(case.monitor(case.folder / "none"))


def test_digest_depends_on_values_and_contents_alone(case, tmp_path):
    digest = case.task().digest
    assert case.task().digest == digest
    assert case.task(sigma=0.3).digest != digest
    shutil.copytree(case.folder, tmp_path / "moved", ignore=shutil.ignore_patterns("out", "none"))
    again = Case.__new__(Case)
    again.kind, again.folder = case.kind, tmp_path / "moved"
    again.inputs = CASES[case.kind](again.folder)
    if case.kind is not PopulationTask:  # the table of a population contains paths
        assert again.task().digest == digest


def test_tasks_can_be_pickled(case):
    task = case.task()
    assert pickle.loads(pickle.dumps(task)).digest == task.digest


def test_result_has_its_kind_facts_and_partial_results(case):
    found, facts = case.found, case.found.facts
    assert type(found) is case.kind.result
    assert task_of(found) is case.kind
    assert facts.headline
    assert facts.outcome not in (Outcome.MISSING, Outcome.FAILED)
    assert facts.is_complete
    assert case.partial or case.kind is PopulationTask  # other processes solve its rows


def test_solving_again_gives_the_same_bits(case, saved, tmp_path):
    again = case.task().solve(case.monitor(tmp_path / "again"))
    again.save(tmp_path / "again.npz")
    assert_same_arrays(arrays_of(saved), arrays_of(tmp_path / "again.npz"))


def test_saved_result_is_loaded_equal(case, saved, tmp_path):
    loaded = abfm.load(saved)
    assert type(loaded) is type(case.found)
    assert loaded.facts == case.found.facts
    loaded.save(tmp_path / "again.npz")
    assert_same_arrays(arrays_of(saved), arrays_of(tmp_path / "again.npz"))


def test_facts_of_the_file_are_those_of_the_result(case, saved):
    facts = case.kind.file.facts(saved)
    assert facts.outcome is case.found.facts.outcome
    assert facts.warnings == case.found.facts.warnings or not facts.warnings


def test_damaged_files_are_refused(case, saved):
    saved.write_bytes(saved.read_bytes()[:-100])
    for read in (abfm.load, case.kind.file.facts, case.kind.file.preview):
        with raises(AbfmError, "result.npz"):
            read(saved)


def test_report_is_plain_json_and_lines(case):
    details = json.loads(json.dumps(case.kind.report.details(case.found), allow_nan=False))
    assert details
    lines = case.kind.report.lines(case.found)
    assert lines
    assert all(line.isprintable() for line in lines)
    assert isinstance(case.kind.report.advice(case.found, "result.npz"), str)


def test_exports_and_tables_are_written(case, tmp_path):
    for suffix, export in case.kind.exports.items():
        name = "speed-lh" if suffix == ".stc" else "lh.sphere"
        path = tmp_path / f"{name}{suffix}"
        export.check(path)
        export.write(path, case.found)
        assert path.stat().st_size
    for name, table in case.kind.tables.items():
        table.write(tmp_path / f"{name}.csv", case.found)
        assert "," in (tmp_path / f"{name}.csv").read_text().splitlines()[0]


def test_preview_shows_functions_on_a_surface(case, saved):
    mesh, functions = case.kind.file.preview(saved)
    assert len(functions) == len(case.kind.preview_labels)
    assert all(values.shape == (len(mesh.vertices),) for values in functions)


def test_cancelled_task_keeps_the_best_result(case, tmp_path):
    monitor = case.monitor(tmp_path / "out", lambda _: monitor.control.cancel())
    if case.kind is PopulationTask:
        monitor.control.cancel()
        with pytest.raises(CancelledError):
            case.task().solve(monitor)
        return
    found = case.task().solve(monitor)
    assert type(found) is case.kind.result
    found.save(tmp_path / "result.npz")
    assert abfm.load(tmp_path / "result.npz").facts.outcome is found.facts.outcome


def test_checkpoint_resumes_to_the_same_bits(case, saved, tmp_path):
    if case.kind not in (SequenceTask, PopulationTask):
        return  # short tasks have no checkpoint
    notes, first = [], case.monitor(tmp_path / "out", lambda _: first.control.cancel())
    if case.kind is SequenceTask:
        case.task().solve(first)
        assert first.checkpoints[0].is_file()
    second = case.monitor(tmp_path / "out")
    second = type(second)(on_note=notes.append, checkpoint=second.checkpoint)
    found = case.task().solve(second)
    assert notes or case.kind is PopulationTask
    found.save(tmp_path / "resumed.npz")
    assert_same_arrays(arrays_of(saved), arrays_of(tmp_path / "resumed.npz"))


def test_row_of_a_table_gives_the_same_result(case, saved, tmp_path):
    if case.kind.kind not in KINDS:
        return  # a population is not a row of a table
    [entry] = run([case.row(task=case.kind.kind)], tmp_path / "out", Cluster(jobs=1))
    assert entry.path is not None, entry.reason
    assert entry.facts.outcome is case.found.facts.outcome
    assert_same_arrays(arrays_of(saved), arrays_of(entry.path))
    [again] = run([case.row(task=case.kind.kind)], tmp_path / "out", Cluster(jobs=1))
    assert again.record == entry.record

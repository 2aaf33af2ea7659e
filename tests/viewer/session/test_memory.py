"""Memory of a session: unused meshes keep only the data that undo and unsaved documents need."""

import gc
import threading
import weakref

import numpy as np
import pytest

from abfm import Parameters
from abfm_viewer.computing import evaluation
from abfm_viewer.document.document import Channel
from abfm_viewer.files.project import Origin
from abfm_viewer.session import editor
from abfm_viewer.session.session import Session
from tests.mesh_writers import off_file
from tests.processes import children
from tests.shapes import icosphere
from tests.viewer.sessions import matched, ready, until

PAIRS = Channel("coordinate:x", "coordinate:y")


@pytest.fixture
def session():
    session = Session(icosphere(1), "first")
    session.editor.amend(channels=(PAIRS,), parameters=Parameters.of(iterations=2, refine=0))
    ready(session)
    yield session
    session.close()


def show(session, *names):
    """Open meshes with functions, and wait until these are evaluated."""
    for name in names:
        session.set_mesh(icosphere(1), name)
        session.editor.amend(channels=(PAIRS,))
        session.update()
        ready(session)


def undo(session, steps, waits=True):
    for _ in range(steps):
        session.undo()
        session.update()
    if waits:
        ready(session)


def threads():
    return sorted(thread.name for thread in threading.enumerate())


def test_other_meshes_have_no_threads(session):
    first, values = session.surface().mesh, session.values("source")
    show(session, "second")
    most = len(threads()) + 1  # one more thread may have run at the same time
    show(session, *(f"mesh {number}" for number in range(12)))
    until(lambda: len(threads()) <= most, session)
    undo(session, 13, waits=False)
    assert session.surface().mesh is first
    assert session.values("source") is values  # shown values are stored
    assert session.outdated is False
    session.editor.set_spec("source", "coordinate:z")  # other functions are evaluated again
    ready(session)
    np.testing.assert_array_equal(session.values("source"), first.vertices[:, 2])
    until(lambda: len(threads()) <= most, session)


def test_caches_of_other_meshes_are_dropped(session):
    first = matched(session).surface().mesh
    assert first.cache
    show(session, "second", "third")
    assert not first.cache
    undo(session, 3)  # also undoes the match
    assert matched(session).result.mesh is first
    assert first.cache


def test_meshes_outside_the_history_are_released(session, tmp_path, monkeypatch):
    monkeypatch.setattr(editor, "UNDO_STEPS_MAX", 5)
    seen = weakref.WeakSet()
    for number in range(9):
        show(session, f"mesh {number}")
        seen.add(session.surface().mesh)
        session.saves.record(session.document, Origin.of(tmp_path / f"{number}.abfm"))
    gc.collect()
    assert len(seen) <= 5 + 2  # 5 undo steps, the current mesh, the latest job


def test_unsaved_results_outside_the_history_are_kept(session, monkeypatch):
    monkeypatch.setattr(editor, "UNDO_STEPS_MAX", 2)
    found = matched(session).result
    show(session, *(f"mesh {number}" for number in range(5)))
    assert found in [unsaved.result for unsaved in session.saves.unsaved_documents]


def test_memory_of_the_history_is_bounded(session, monkeypatch):
    held = vars(matched(session).result).values()
    size = sum({id(part): part.nbytes for part in held if isinstance(part, np.ndarray)}.values())
    del held
    monkeypatch.setattr(editor, "UNDO_BYTES_MAX", 5 * size)
    before, seen = threads(), weakref.WeakSet()
    for number in range(15):
        session.editor.set_parameter(alpha=1.0 + number)
        seen.add(matched(session).result)
        if number % 3 == 0:
            session.undo()
    gc.collect()
    assert len(seen) <= 5 + 3
    steps = 0
    while session.editor.undo_label:
        session.undo()
        steps += 1
    assert steps > 5
    assert set(threads()) - set(before) <= {"solver"}


def test_the_latest_step_can_always_be_undone(session, monkeypatch):
    monkeypatch.setattr(editor, "UNDO_BYTES_MAX", 0)
    start = session.document
    found = matched(session).result
    session.editor.set_parameter(alpha=3.0)
    session.undo()
    assert session.result is found
    session.editor.amend(result=None, runs=())
    session.editor.set_parameter(alpha=4.0)
    session.undo()
    assert session.parameters == start.parameters


def test_only_the_current_mesh_has_an_evaluation_process(session, monkeypatch):
    monkeypatch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", 0)
    before = children()
    show(session, *(f"mesh {number}" for number in range(3)))
    until(lambda: len(children() - before) == 1, session)


def test_values_from_files_are_kept_with_unused_meshes(session, tmp_path):
    values, path = np.linspace(0, 1, len(session.surface().mesh.vertices)), tmp_path / "values.npy"
    np.save(path, values)
    for spec in (f"file:{path}", "coordinate:z"):
        session.editor.set_spec("source", spec)
        ready(session)
    show(session, "second")
    path.unlink()
    undo(session, 2)
    np.testing.assert_allclose(session.values("source"), values)


def test_names_of_samples_are_released_with_their_documents(desk, tmp_path):
    path = off_file(tmp_path / "small.off", icosphere(1))
    for _ in range(3):
        desk.open(path)
        desk.session.reset_history()
        desk.settle()
    gc.collect()
    assert len(desk.files._samples) <= 2

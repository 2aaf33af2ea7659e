import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import nibabel
import numpy as np
import pytest

from abfm import AbfmError, MeshError, Parameters, Problem, load, match
from abfm.io import export_vtu
from abfm_viewer.document.document import Channel
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.files import documents
from abfm_viewer.files.contents import is_named_as_frames
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.session import session_files
from abfm_viewer.session.loading import Load, Loading
from abfm_viewer.session.notices import Notices
from abfm_viewer.session.session_files import open_session
from abfm_viewer.window.samples import figure_document
from tests.mesh_writers import freesurfer_bytes, off_file
from tests.messages import check_message, raises
from tests.processes import python
from tests.shapes import icosphere, with_thin_triangles
from tests.viewer.sessions import ENDLESS, QUICK, matched, solving, until


@pytest.fixture
def small(tmp_path):
    return off_file(tmp_path / "small.off", icosphere(1))


@pytest.fixture
def solved(desk):
    desk.session.editor.amend(parameters=QUICK)
    matched(desk.session)
    return desk


def save(desk, path, **words):
    desk.files.save(path, **words)
    desk.settle()


def names(desk):
    """Return the names of the documents that would be lost."""
    return [document.name for document in desk.session.saves.unsaved_documents]


def results(desk):
    return [document.result for document in desk.session.saves.unsaved_documents]


def test_opened_result_has_its_functions(desk, tmp_path):
    session = desk.session
    f = np.stack([session.values("source"), session.values("target")], axis=1)
    mesh, mask, back = session.surface().mesh, np.linspace(0.5, 1, len(f)), f[:, ::-1].copy()
    found = match(mesh, f, back, Parameters.of(iterations=2, refine=0), mask=mask, weights=[1, 3])
    found.save(tmp_path / "two words.npz")
    desk.open(tmp_path / "two words.npz")
    assert [channel.weight for channel in session.channels] == [1, 3]
    assert np.array_equal(session.values("source"), f[:, 0])
    assert np.array_equal(session.result.velocity, found.velocity)
    assert (session.outdated, session.saves.unsaved) == (False, False)
    assert session.time == found.parameters.tau
    save(desk, tmp_path / "result.abfm")
    (tmp_path / "two words.npz").unlink()
    desk.open(tmp_path / "result.abfm")
    assert np.array_equal(session.values("target"), f[:, 1])
    assert not session.outdated
    desk.settle()


def test_functions_given_as_text_open_as_text(desk, tmp_path):
    mesh, text = desk.session.surface().mesh, "gaussian:vertex=3,width=0.3"
    np.savetxt(tmp_path / "g.txt", target := np.linspace(0, 1, len(mesh.vertices)))
    p = Parameters.of(iterations=2, refine=0)
    problem = Problem(mesh, text, f"file:{tmp_path / 'g.txt'}", p)
    match(problem).save(tmp_path / "m.npz")
    (tmp_path / "g.txt").unlink()
    desk.open(tmp_path / "m.npz")
    [channel] = desk.session.channels
    assert channel.source == text
    assert str(tmp_path / "m.npz") in channel.target
    assert np.array_equal(desk.session.values("source"), problem.source[:, 0])
    assert np.allclose(desk.session.values("target"), target)
    assert not desk.session.outdated


def test_save_writes_the_file_of_the_current_document(desk, tmp_path):
    session = desk.session
    session.editor.set_parameter(alpha=3)
    for name in ("first", "second"):
        save(desk, tmp_path / f"{name}.abfm")
    desk.open(tmp_path / "first.abfm")
    assert session.saves.path == tmp_path / "first.abfm"
    session.undo()
    assert session.saves.path == tmp_path / "second.abfm"
    assert not session.saves.unsaved
    session.redo()
    assert session.saves.path == tmp_path / "first.abfm"


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("notes.md", b"", (".obj", ".off")),
        ("notes.txt", b"a b", ("notes.txt",)),
        ("broken.off", b"OFF 3", ("broken.off",)),
        ("broken.abfm", b"PK", ("broken.abfm",)),
        ("broken.npz", b"PK", ("broken.npz",)),
        ("words.csv", b"name,mesh\na,b.off\n", ("words.csv",)),
        ("missing.off", None, ()),
        ("missing.abfm", None, ()),
        ("~no-user/m.csv", None, ("m.csv",)),
    ],
)
def test_files_that_cannot_be_opened_change_nothing(desk, tmp_path, name, content, named):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    was = desk.session.document
    path = Path(name) if name.startswith("~") else tmp_path / name
    desk.open(path)
    assert desk.session.notices.latest.is_error
    check_message(desk.session.notices.latest.text, *named)
    assert desk.session.document is was
    assert desk.state.recent() == []


@pytest.mark.parametrize("suffix", ["npz", "abfm"])
def test_inconsistent_result_is_recomputed_on_opening(solved, tmp_path, suffix):
    found, path = solved.session.result, tmp_path / f"cheat.{suffix}"
    cheat = replace(found, fine_velocity=0 * found.velocity)
    solved.session.editor.amend(result=cheat)
    if suffix == "npz":
        cheat.save(path)
    else:
        save(solved, path)
    solved.files.open(path)
    until(lambda: solved.session.notices.cards, solved.session)
    [card] = solved.session.notices.cards
    check_message(card.text, path.name)
    judged = solved.session.result
    assert judged.verdict.kind == "not reached"
    assert judged.residual == pytest.approx(found.initial_residual)


def test_saves_are_written_in_order_and_reported(desk, tmp_path, monkeypatch):
    usual, done = session_files.save_project, []

    def write(path, *words):
        time.sleep(0.1 if path.stem == "a" else 0)
        usual(path, *words)
        done.append(f"written {path.stem}")

    monkeypatch.setattr(session_files, "save_project", write)
    for name in "abc":
        desk.files.save(tmp_path / f"{name}.abfm", then=lambda name=name: done.append(name))
    desk.files.when_saved(lambda: done.append("end"))
    assert desk.files.saving
    desk.settle()
    assert [one for one in done if len(one) == 1] == ["a", "b", "c"]
    assert [one for one in done if "written" in one] == [f"written {name}" for name in "abc"]
    assert done[-1] == "end"
    assert sorted(path.name for path in tmp_path.glob("*.abfm")) == ["a.abfm", "b.abfm", "c.abfm"]


def test_files_are_complete_when_the_program_ends(tmp_path):
    """Files are complete even if the program ends without closing the session."""
    code = """if True:
        import sys, time
        from pathlib import Path
        from abfm_viewer.files.autosave import Autosave, StateFolder
        from abfm_viewer.session import session_files
        from abfm_viewer.session.session import Session
        from tests.shapes import icosphere, with_thin_triangles

        def slow(*_):
            time.sleep(0.5)
            return {}

        session, folder = Session(icosphere(1), "sphere"), Path(sys.argv[1])
        session_files.known_values = slow
        session_files.SessionFiles(session, None, print).save(folder / "saved.abfm")
        copies = Autosave(StateFolder(folder), seconds=0)
        copies.offer(session.document, lambda: (session.document, slow()), True)
    """
    done = python(code, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert [load_project(path)[0].name for path in tmp_path.iterdir()] == ["sphere", "sphere"]


def test_changes_made_while_saving_stay_unsaved(desk, tmp_path):
    desk.session.editor.set_parameter(alpha=3)
    desk.files.save(tmp_path / "a.abfm")
    desk.session.editor.set_parameter(alpha=4)
    desk.settle()
    assert desk.session.saves.unsaved
    desk.session.undo()
    assert not desk.session.saves.unsaved


def test_session_opens_any_file_without_history(desk, tmp_path):
    f, g = map(desk.session.values, ("source", "target"))
    found = match(desk.session.surface().mesh, f, g, Parameters.of(iterations=3, refine=0))
    found.save(tmp_path / "m.npz")
    channels = (Channel("coordinate:x", "coordinate:y"),)
    desk.session.editor.change("solve", result=found, channels=channels)
    save(desk, tmp_path / "p.abfm")
    for name in ("m.npz", "p.abfm"):
        session = open_session(tmp_path / name)
        assert np.array_equal(session.result.velocity, load(tmp_path / "m.npz").velocity)
        assert (session.editor.undo_label, session.saves.unsaved) == ("", False)
        assert (session.saves.path is None) == (name == "m.npz")
        session.close()
    with pytest.raises(MeshError):
        open_session(tmp_path / "missing.off")


def frames_of(desk):
    """Return the values of the current sequence, (T, V)."""
    desk.wait(lambda: isinstance(desk.session.document, SequenceDocument))
    return desk.session.document.sequence.frames.values[:, :, 0]


@pytest.mark.parametrize("name", ["f.npz", "f.txt", "f.gii"])
def test_every_file_of_frames_opens(desk, tmp_path, name):
    mesh, path = desk.session.surface().mesh, tmp_path / name
    frames = np.float32(np.random.default_rng(3).normal(size=(3, len(mesh.vertices))))
    if name.endswith(".gii"):
        arrays = [nibabel.gifti.GiftiDataArray(frame) for frame in frames]
        nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)
    elif name.endswith(".npz"):
        # other arrays have names that abfm also uses
        others = {"vertices": mesh.vertices, "velocity": frames}
        np.savez(path, frames=frames, times=[0, 0.5, 1], **others)
    else:
        np.savetxt(path, frames.T)
    file = off_file(tmp_path / "mesh.off", mesh)
    session = open_session(file, second=path)
    assert session.document.name == f"{name} on mesh.off"
    assert session.document.sequence.unit == ("s" if name.endswith(".npz") else "")
    session.close()
    desk.files.open(path)
    np.testing.assert_allclose(frames_of(desk), frames, atol=1e-6)
    desk.files.open(file)
    desk.settle()
    desk.files.open_dropped([path, file])
    np.testing.assert_allclose(frames_of(desk), frames, atol=1e-6)
    if not name.endswith(".gii"):
        with raises(AbfmError, "MESH", name):
            open_session(path)


def test_freesurfer_surfaces_and_single_grids_are_meshes(desk, tmp_path):
    sphere = icosphere(1)
    export_vtu(tmp_path / "m.vtu", sphere, {"f": sphere.vertices[:, 0]}, {})
    (tmp_path / "rh.inflated").write_bytes(freesurfer_bytes(sphere.vertices, sphere.faces))
    for name in ("m.vtu", "rh.inflated"):
        desk.open(tmp_path / name)
        assert desk.session.surface().name == name
        np.testing.assert_array_equal(desk.session.surface().mesh.faces, sphere.faces)
    assert not is_named_as_frames(tmp_path / "m.vtu")
    assert is_named_as_frames(tmp_path / "wave_0001.vtu")


def test_user_chooses_one_of_several_arrays(desk, tmp_path):
    mesh, path = desk.session.surface().mesh, tmp_path / "two.npz"
    frames = np.random.default_rng(4).normal(size=(3, len(mesh.vertices)))
    np.savez(path, u=frames, v=-frames)
    file = off_file(tmp_path / "mesh.off", mesh)
    session = open_session(file, second=path, array="u")
    np.testing.assert_array_equal(session.document.sequence.frames.values[:, :, 0], frames)
    session.close()
    with raises(AbfmError, "u", "array"):
        open_session(file, array="u")


def test_result_of_a_closed_document_stays_unsaved(solved, small, tmp_path):
    session, found = solved.session, solved.session.result
    solved.open(small)
    assert not session.saves.unsaved
    [unsaved] = session.saves.unsaved_documents
    assert unsaved.result is found
    assert session.saves.has_new_result(unsaved)
    save(solved, tmp_path / "unsaved.abfm", document=unsaved)
    assert session.saves.unsaved_documents == ()
    session.undo()
    assert session.result is found
    assert session.saves.path == tmp_path / "unsaved.abfm"
    assert not session.saves.unsaved


def test_changes_of_other_documents_are_unsaved(desk, small):
    desk.session.editor.set_parameter(alpha=3)
    desk.open(small)
    for step in range(300):  # more steps than undo stores
        desk.session.editor.set_parameter(alpha=4 + step / 100)
    assert names(desk) == ["small.off", "sphere.off"]
    desk.open(small)
    assert names(desk) == ["sphere.off", "small.off"]


def test_documents_closed_by_undo_and_redo_are_unsaved(desk, small):
    desk.open(small)
    desk.session.editor.set_parameter(alpha=3)
    for _ in range(2):
        desk.session.undo()
    assert names(desk) == []  # undo also reverted the change
    for _ in range(2):
        desk.session.redo()
    assert names(desk) == ["small.off"]
    matched(desk.session)
    for _ in range(3):
        desk.session.undo()
    assert desk.session.document.name == "sphere.off"
    assert names(desk) == ["small.off"]
    assert results(desk)[0] is not None


def test_undone_result_is_unsaved(solved, tmp_path):
    session, found = solved.session, solved.session.result
    session.undo()
    session.editor.amend(parameters=Parameters())
    assert not session.saves.unsaved
    assert results(solved) == [found]
    save(solved, tmp_path / "chosen.abfm")
    assert session.saves.unsaved_documents == ()


def test_save_does_not_cover_a_later_result(solved, small, tmp_path):
    solved.files.save(tmp_path / "a.abfm")
    later = matched(solved.session).result
    solved.settle()
    solved.open(small)
    assert results(solved) == [later]


def test_opening_during_a_run_needs_a_confirmation(desk, small, tmp_path):
    session = desk.session
    session.editor.amend(parameters=ENDLESS)
    solving(session)
    desk.files.open(tmp_path / "song.mp3")
    assert desk.questions == []
    for opening in (
        lambda: desk.files.open(small),
        lambda: desk.files.open_dropped([small]),
        lambda: desk.files.open_made("figure 1", partial(figure_document, 1)),
    ):
        desk.questions.clear()
        opening()
        [(title, text, answers, instead)] = desk.questions
        assert title == "End the run?"
        check_message(text, "sphere.off")
        assert answers["Go back"] is None
        assert instead() is None
        desk.update()
        assert session.solver.running
        assert session.loading.now is None
    answers["End the run"]()
    desk.wait(lambda: session.document.name != "sphere.off")
    assert [result is not None for result in results(desk)] == [True]
    session.undo()
    assert session.result.velocity.any()


def test_replaced_request_is_reported(desk, small, tmp_path):
    desk.files.open(tmp_path / "first.off")
    desk.files.open(small)
    text = desk.session.notices.latest.text
    check_message(text, "small.off", "first.off")
    desk.settle()
    assert desk.session.document.name == "small.off"


@pytest.mark.parametrize("is_over", [False, True])
def test_long_request_ends_only_on_confirmation(desk, small, is_over):
    may_end = threading.Event()

    def make(folder):
        may_end.wait(60)
        raise AbfmError("none was made")

    desk.files.open_made_table("A population", make)
    desk.files.open(small)
    [(title, text, answers, instead)] = desk.questions
    assert title == "Cancel the current task?"
    check_message(text, "small.off")
    assert answers["Go back"] is None
    assert instead() is None
    loading = desk.session.loading
    if is_over:
        may_end.set()
        desk.wait(lambda: loading.now is None)
        instead()()
        end = "because setting up a population has ended meanwhile; try again"
        text = f"opening small.off was not started, {end}"
        assert desk.session.notices.latest.text == text
    else:
        assert loading.now.what == "setting up a population"
        answers["Cancel setting up a population"]()
        may_end.set()
        desk.settle()
    assert (desk.session.document.name == "small.off") != is_over


class Slow:
    """A read that waits for the test, and counts its starts and displays."""

    def __init__(self):
        self.started = self.shown = 0
        self.may_end = threading.Event()

    def __call__(self):
        self.started += 1
        assert self.may_end.wait(30)
        return self.show

    def show(self):
        self.shown += 1


@pytest.fixture
def slow():
    slow = Slow()
    yield slow
    slow.may_end.set()


@pytest.fixture
def quick():
    quick = Slow()
    quick.may_end.set()
    return quick


@pytest.fixture
def loading(jobs):
    return Loading(jobs, Notices(lambda: 0))


def begin(loading, read, source=None, waits=True):
    before = read.started
    loading.begin(Load("reading", read, source=source))
    until(lambda: not waits or read.started > before)


def finish(loading):
    """Wait until the current request has been shown."""
    until(lambda: loading.update() or loading.now is None)


def test_cancelled_request_is_not_shown(loading, slow, quick):
    begin(loading, slow)
    loading.cancel()
    assert loading.now is None
    slow.may_end.set()
    begin(loading, quick)
    finish(loading)
    loading.update()
    assert (slow.shown, quick.shown) == (0, 1)


def test_repeated_request_is_read_once(loading, slow):
    begin(loading, slow, "a file")
    for _ in range(3):
        loading.cancel()
        begin(loading, slow, "a file", waits=False)
    slow.may_end.set()
    for count in (1, 2):  # after its end, a request is read again
        finish(loading)
        assert (slow.started, slow.shown) == (count, count)
        begin(loading, slow, "a file")


def test_other_sources_are_read_immediately(loading, slow, quick):
    begin(loading, slow, "a file")
    begin(loading, quick, "another file")
    finish(loading)
    assert (slow.shown, quick.shown) == (0, 1)
    begin(loading, slow, "a file", waits=False)
    slow.may_end.set()
    finish(loading)
    assert (slow.started, slow.shown) == (1, 1)


def test_request_cancelled_before_its_start_blocks_nothing(loading, slow):
    for _ in range(20):
        begin(loading, slow, "a file", waits=False)
        loading.cancel()
    begin(loading, slow, "a file", waits=False)
    slow.may_end.set()
    finish(loading)
    assert slow.shown == 1


def test_closing_does_not_wait_for_cancelled_requests(jobs, loading, slow):
    begin(loading, slow)
    reader = loading._reader
    loading.cancel()
    jobs.close()
    assert reader.is_running


def test_project_of_landmarks_is_consistent_with_its_field(tmp_path):
    mesh = with_thin_triangles(icosphere(2))
    pairs = np.random.default_rng(3).choice(162, (4, 2), replace=False)
    found = match(Problem(mesh, None, None, landmarks=pairs))
    document, known = documents.document_of_result(found, tmp_path / "found.npz")
    save_project(tmp_path / "found.abfm", document, known)
    opened = load_project(tmp_path / "found.abfm")[0].result
    assert opened.load_warning == ""
    assert opened.residual == found.residual
    assert np.array_equal(opened.landmark_errors, found.landmark_errors)


def test_opened_document_changes_as_a_whole(desk, tmp_path):
    """When the panel shows a document, its functions and its front are known."""
    session, path = desk.session, tmp_path / "other.abfm"
    session.editor.set_spec("source", "gaussian:vertex=3,width=0.3")
    save_project(path, session.document, {})
    desk.settle()
    before = session.document.identity
    desk.files.open(path)
    while session.document.identity is before:
        assert all(session.values(side) is not None for side in ("source", "target"))
        desk.update()
    assert session.surface().front is not None
    assert all(session.values(side) is not None for side in ("source", "target"))


def test_meshes_and_frames_opened_together_are_one_recent_entry(desk, tmp_path):
    a, b = (off_file(tmp_path / f"{name}.off", icosphere(1)) for name in "ab")
    frames = tmp_path / "waves.npy"
    np.save(frames, np.random.default_rng(0).random((3, 42)))
    desk.open(a)
    desk.files.open_second(b)
    desk.settle()
    assert desk.state.recent() == [(a, b)]
    desk.session.undo()
    desk.files.open_frames(frames)
    until(lambda: desk.session.document.name == "waves.npy on a.off", desk)
    assert desk.state.recent() == [(a, frames), (a, b)]
    desk.session.undo()
    for paths, name in (((a, frames), "waves.npy on a.off"), ((a, b), "a.off to b.off")):
        desk.files.open_together(paths)
        until(lambda name=name: desk.session.document.name == name, desk)
    assert desk.state.recent()[0] == (a, b)
    desk.session.undo()  # one step
    assert desk.session.document.name == "waves.npy on a.off"

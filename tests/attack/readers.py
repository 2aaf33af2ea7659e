"""Readers of the files that users open, and checks of the promises about each."""

import contextlib
import io
import re
from functools import cache
from pathlib import Path

import numpy as np

import abfm
from abfm import AbfmError
from abfm.batch import read_table
from abfm.errors import MESSAGE_LENGTH_MAX
from abfm.functions.labels import read_labels
from abfm.population.subjects import read_subjects
from abfm.registration.initial.landmark_pairs import read_landmarks
from abfm.sequences import read_frames
from abfm_viewer.cli import main
from abfm_viewer.document.document import THEMES
from abfm_viewer.files.autosave import recoverable
from abfm_viewer.files.preferences import PreferenceFile
from abfm_viewer.files.project import load_origin, load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session import Session
from abfm_viewer.window.session_preferences import SessionPreferences
from tests.attack.specimens import MESH
from tests.attack.trial import FaultError

_INNER = re.compile(
    r"\b__\w+__\b|NoneType|object has no attribute|not subscriptable|unhashable|slice indices"
    r"|No module named|usecols|invalid literal|could not convert|base 10|codec can't|set_int_max"
    r"|positional argument|\w+\(\) (argument|takes)|has no len|not iterable"
    r"|unsupported operand|<\w+ object|index out of range|out of bounds for|Python int"
)
"""Words of Python, which no message may contain unless they are the user's own."""


def read_as(reader, path):
    """Read a file. An `AbfmError` is a correct refusal of the file; any other error is a fault."""
    try:
        READERS[reader](path)
    except AbfmError as error:
        text = str(error)
        given = path.read_bytes() if reader == "spec" else b""
        words = [found[0] for found in _INNER.finditer(text.replace(str(path), ""))]
        faults = {
            f"{len(text)} characters": len(text) > MESSAGE_LENGTH_MAX,
            f"{len(text.splitlines())} lines": len(text.splitlines()) != 1,
            "characters that cannot be printed": not text.isprintable() and max(text) < "\udc80",
            "the words of Python": not all(each.encode() in given for each in words),
        }
        if found := [what for what, is_so in faults.items() if is_so]:
            raise FaultError(f"an error of {', '.join(found)}: {text[:300]!r}") from error
        raise


def _check_mesh(mesh):
    V, area = len(mesh.vertices), mesh.length_scale**2
    assert mesh.vertices.shape == (V, 3)
    assert mesh.faces.shape == (len(mesh.faces), 3)
    assert np.isfinite(mesh.vertices).all()
    assert np.array_equal(np.unique(mesh.faces), np.arange(V))
    assert mesh.vertex_ids.shape == (V,)
    assert mesh.vertex_ids.max() < mesh.file_vertex_count
    assert 0 < area < np.inf
    assert all(
        len(text.splitlines()) == 1 and len(text) <= MESSAGE_LENGTH_MAX for text in mesh.messages
    )


def _check_values(values, mesh=MESH):
    assert values.shape == mesh.vertices.shape[:1]
    assert values.dtype == np.float64
    assert np.isfinite(values).all()


def _values(path):
    column = ",column=0" if path.name.startswith("two") or path.suffix == ".csv" else ""
    label = ",label=a" if path.name.endswith((".annot", ".label.gii")) else ""
    _check_values(abfm.function(MESH, f'file:"{path}"{column}{label}'))


def _map(path):
    target = abfm.functions.vertex_map(MESH, str(path))
    assert target.shape == MESH.vertices.shape[:1]
    assert target.dtype.kind == "i"
    assert 0 <= target.min() <= target.max() < len(MESH.vertices)


def _result(path):
    match, again = abfm.load(path), path.with_name("again.npz")
    _check_match(match)
    match.save(again)
    assert abfm.load(again).residual == match.residual
    assert np.isfinite(match.advect(match.parameters.tau / 2)).all()


def _check_match(match):
    _check_mesh(match.mesh)
    V, F, C = len(match.mesh.vertices), len(match.mesh.faces), len(match.weights)
    arrays = [match.source, match.target, match.advected, match.velocity]
    assert [each.shape for each in arrays] == [*(3 * [(V, C)]), (len(match.velocity), F, 3)]
    assert all(np.isfinite(each).all() for each in arrays)
    assert (match.weights >= 0).all()
    assert match.mask is None or (match.mask >= 0).all()
    assert len(match.energy_history) == len(match.stages)
    assert 0 <= match.residual < np.inf


def _project(path):
    document, known = load_project(path)
    load_origin(path)
    recoverable(StateFolder(path.parent))
    mesh = document.surface().mesh
    _check_mesh(mesh)
    if document.result is not None:
        _check_match(document.result)
    for values in known.values():
        _check_values(values, mesh)
    assert np.isfinite([document.time, document.parameters.tau]).all()
    again = path.with_name("again.abfm")
    save_project(again, document, known)
    assert load_project(again)[0].channels == document.channels
    session = _session()
    session.restore(document, known, None)
    session.reset_history()
    session.update()
    assert session.document.identity is document.identity


@cache
def _session():
    return Session(MESH, "ball", at_once=True)


def _state(path):
    """Read a file in which the app stores its state between launches."""
    state, was_file = StateFolder(path.parent), path.is_file() and not path.is_symlink()
    assert all(isinstance(p, Path) for paths in state.recent() for p in paths)
    preferences = PreferenceFile(state)
    SessionPreferences(_session(), preferences)
    assert _session().view.theme in THEMES
    assert 0.5 <= _session().view.ui_scale <= 4
    state.add_recent(path)
    preferences.change(theme="dark")
    is_preserved = (path,) in state.recent() and PreferenceFile(state).now.theme == "dark"
    assert is_preserved or not was_file


def _spec(path):
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    parsed = abfm.functions.parse(text)
    assert abfm.functions.parse(str(parsed)) == parsed
    _check_values(abfm.function(MESH, text))


def _frames(path):
    found = read_frames(path, MESH, "u" if path.suffix in (".vtu", ".pvd") else None)
    assert found.values.ndim in (2, 3)
    assert found.values.dtype == np.float64
    assert found.times is None or found.times.shape == found.values.shape[:1]


def _labels(path):
    found = read_labels(path)
    assert found.values.dtype.kind == "i"
    assert all(name.isprintable() for name in found.names.values())


def _batch(path):
    """Read a folder of two rows with one changed file; the other rows must be reported."""
    folder = path.parent.parent if path.suffix == ".json" else path.parent

    def around():
        return {each: each.stat().st_mtime_ns for each in folder.parent.iterdir() if each != folder}

    before, out, errors = around(), io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        status = main(["batch", "--status", str(folder), "--quiet", "--no-pictures"])
    printed, refusal = out.getvalue().splitlines(), errors.getvalue().splitlines()
    assert status in (0, 2, 3, 4)
    assert all(map(str.isprintable, printed + refusal)), f"printed: {printed + refusal}"[:300]
    assert around() == before
    if status == 2:
        assert len(refusal) == 1
        assert path.name == "rows.json", f"rows are hidden: {refusal}"
        raise AbfmError(refusal[0])
    assert path.name == "rows.json" or printed[0].startswith("2 rows: "), f"printed: {printed}"
    text = (folder / "summary.csv").read_text(encoding="utf-8")
    assert all(map(str.isprintable, text.splitlines()))
    assert not re.search(r'(^|,)"?[=+@]', text, re.MULTILINE)


READERS = {
    "frames": _frames,
    "labels": _labels,
    "table": read_table,
    "subjects": read_subjects,
    "landmarks": lambda path: read_landmarks(MESH, MESH, str(path)),
    "batch": _batch,
    "mesh": lambda path: _check_mesh(abfm.load_mesh(path)),
    "values": _values,
    "map": _map,
    "result": _result,
    "project": _project,
    "state": _state,
    "spec": _spec,
}

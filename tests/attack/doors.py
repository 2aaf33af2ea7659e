"""The doors through which users open files, and the promises about each."""

import contextlib
import io
import re
from functools import cache
from pathlib import Path

import numpy as np

import abfm
from abfm import AbfmError
from abfm.batch import read_table
from abfm.errors import LONGEST
from abfm.functions.labels import read_labels
from abfm.population.subjects import read_subjects
from abfm.registration.initial.landmark_pairs import read_landmarks
from abfm.sequences import read_frames
from abfm_viewer.cli import main
from abfm_viewer.document.document import THEMES
from abfm_viewer.files.autosave import recoverable
from abfm_viewer.files.project import load_origin, load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session import Session
from abfm_viewer.window.recovery import Preferences
from tests.attack.hunt import FaultError
from tests.attack.specimens import MESH

_INNER = re.compile(
    r"\b__\w+__\b|NoneType|object has no attribute|not subscriptable|unhashable|slice indices"
    r"|No module named|usecols|invalid literal|could not convert|base 10|codec can't|set_int_max"
    r"|positional argument|\w+\(\) (argument|takes)|has no len|not iterable"
    r"|unsupported operand|<\w+ object"
)
"""Words that only programmers understand, unless they are the user's own."""


def enter(door, path):
    """Open a file as users do: an `AbfmError` is a refusal as it should be, all else a fault."""
    try:
        DOORS[door](path)
    except AbfmError as error:
        text = str(error)
        told, count = repr(text[:300]), len(text.splitlines())
        _hold(count == 1, f"an error of {count} lines: {told}")
        is_printable = text.isprintable() or max(text) >= "\udc80"
        _hold(is_printable, f"an error that cannot be printed: {told}")
        given = path.read_bytes() if door == "spec" else b""
        inner = [words[0] for words in _INNER.finditer(text.replace(str(path), ""))]
        is_ours = all(words.encode() in given for words in inner)
        _hold(is_ours, f"an error in the words of Python: {told}")
        _hold(len(text) <= LONGEST, f"an error of {len(text)} characters: {told}...")
        raise


def _hold(holds, broken):
    if not holds:
        raise FaultError(broken)


def _check_mesh(mesh):
    V, F, area = len(mesh.vertices), len(mesh.faces), mesh.length_scale**2
    shapes = mesh.vertices.shape == (V, 3) and mesh.faces.shape == (F, 3)
    _hold(shapes and V >= 3 and F >= 1, "a mesh of wrong shapes")
    _hold(np.isfinite(mesh.vertices).all(), "a mesh with vertices that are not finite")
    _hold(np.array_equal(np.unique(mesh.faces), np.arange(V)), "a mesh with wrong indices")
    numbers = mesh.vertex_ids.shape == (V,) and mesh.vertex_ids.max() < mesh.file_vertex_count
    _hold(numbers, "a mesh of wrong numbers")
    _hold(np.isfinite(area) and area > 0, f"a mesh of area {area}")
    lines = all(len(text.splitlines()) == 1 and len(text) <= LONGEST for text in mesh.messages)
    _hold(lines, f"messages of a mesh: {mesh.messages!r}"[:300])


def _check_values(values, mesh=MESH):
    is_right = values.shape == mesh.vertices.shape[:1] and values.dtype == np.float64
    _hold(is_right and np.isfinite(values).all(), f"values of shape {values.shape}, or not finite")


def _values(path):
    column = ",column=0" if path.name.startswith("two") or path.suffix == ".csv" else ""
    label = ",label=a" if path.name.endswith((".annot", ".label.gii")) else ""
    _check_values(abfm.function(MESH, f'file:"{path}"{column}{label}'))


def _map(path):
    target = abfm.functions.vertex_map(MESH, str(path))
    is_right = target.shape == MESH.vertices.shape[:1] and target.dtype.kind == "i"
    _hold(is_right, f"a map of shape {target.shape} and type {target.dtype}")
    are_there = target.min() >= 0 and target.max() < len(MESH.vertices)
    _hold(are_there, "a map to vertices that are not there")


def _result(path):
    match, again = abfm.load_match(path), path.with_name("again.npz")
    _check_match(match)
    match.save(again)
    _hold(abfm.load_match(again).residual == match.residual, "a result that changes when saved")
    _hold(np.isfinite(match.advect(match.parameters.tau / 2)).all(), "values that are not finite")


def _check_match(match):
    _check_mesh(match.mesh)
    V, F, C = len(match.mesh.vertices), len(match.mesh.faces), len(match.weights)
    arrays = [match.source, match.target, match.advected, match.velocity]
    shapes = [*(3 * [(V, C)]), (len(match.velocity), F, 3)]
    _hold([each.shape for each in arrays] == shapes, "a result of wrong shapes")
    _hold(all(np.isfinite(each).all() for each in arrays), "a result that is not finite")
    mask = match.weights if match.mask is None else match.mask
    _hold((match.weights >= 0).all() and (mask >= 0).all(), "a result of negative weights")
    _hold(len(match.energy_history) == len(match.stages), "a result with a history of two lengths")
    _hold(0 <= match.residual < np.inf, f"a result with the residual {match.residual}")


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
    _hold(np.isfinite([document.time, document.parameters.tau]).all(), "times are not finite")
    again = path.with_name("again.abfm")
    save_project(again, document, known)
    _hold(load_project(again)[0].channels == document.channels, "a project that changes when saved")
    session = _session()
    session.restore(document, known, None)
    session.reset_history()
    session.update()
    _hold(session.document.identity is document.identity, "a project that is not opened")


@cache
def _session():
    return Session(MESH, "ball", at_once=True)


def _recent(path):
    state, was_file = StateFolder(path.parent), path.is_file() and not path.is_symlink()
    _hold(all(isinstance(p, Path) for p in state.recent()), "recent files that are no paths")
    state.add_recent(path)
    _hold(path in state.recent() or not was_file, "a recent file is forgotten")


def _preferences(path):
    state, was_file = StateFolder(path.parent), path.is_file() and not path.is_symlink()
    Preferences(_session(), state)
    view = _session().view
    is_right = view.theme in THEMES and 0.5 <= view.ui_scale <= 4
    _hold(is_right, f"the preferences {view.theme} and {view.ui_scale}")
    state.set_preference("theme", "dark")
    _hold(state.preferences().get("theme") == "dark" or not was_file, "a preference is forgotten")


def _spec(path):
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    parsed = abfm.functions.parse(text)
    means_it = abfm.functions.parse(str(parsed)) == parsed
    _hold(means_it, f"a function whose text {str(parsed)[:200]!r} means another")
    _check_values(abfm.function(MESH, text))


def _frames(path):
    found = read_frames(path, MESH, "u" if path.suffix in (".vtu", ".pvd") else None)
    is_right = found.values.ndim in (2, 3) and found.values.dtype == np.float64
    _hold(is_right, f"frames of shape {found.values.shape} and type {found.values.dtype}")
    are_known = found.times is None or found.times.shape == found.values.shape[:1]
    _hold(are_known, "frames with other times")


def _labels(path):
    found = read_labels(path)
    known = all(name.isprintable() for name in found.names.values())
    _hold(found.values.dtype.kind == "i" and known, "labels that are no numbers with names")


def _command(*words):
    """Run a command as users do: it ends with a known status, in words that can be printed."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        status = main([*map(str, words)])
    lines = (out.getvalue() + errors.getvalue()).splitlines()
    _hold(status in (0, 2, 3, 4), f"exit status {status}")
    _hold(all(map(str.isprintable, lines)), f"control characters: {lines[:9]!r}"[:300])
    _hold(status != 2 or len(errors.getvalue().splitlines()) == 1, f"a refusal of lines: {lines}")
    return status, lines


def _batch(path):
    """A file of a folder of two rows: whatever is in it, other rows are still reported."""
    folder = path.parent.parent if path.suffix == ".json" else path.parent
    around = {each: each.stat().st_mtime_ns for each in folder.parent.iterdir() if each != folder}
    status, lines = _command("batch", "--status", folder, "--quiet", "--no-pictures")
    now = {each: each.stat().st_mtime_ns for each in folder.parent.iterdir() if each != folder}
    _hold(now == around, "a file outside the folder of results")
    if status == 2 and path.name == "rows.json":
        raise AbfmError(lines[-1])
    _hold(path.name == "rows.json" or lines[0].startswith("2 rows: "), f"rows are hidden: {lines}")
    text = (folder / "summary.csv").read_text(encoding="utf-8", errors="strict")
    _hold(all(map(str.isprintable, text.splitlines())), "control characters in summary.csv")
    is_formula = re.search(r'(^|,)"?[=+@]', text, re.MULTILINE)
    _hold(not is_formula, f"a formula in summary.csv: {is_formula}")


DOORS = {
    "frames": _frames,
    "labels": _labels,
    "table": lambda path: read_table(path),
    "subjects": lambda path: read_subjects(path),
    "landmarks": lambda path: read_landmarks(MESH, MESH, str(path)),
    "info": lambda path: _hold(_command("info", path)[0] in (0, 2), "another exit status"),
    "batch": _batch,
    "mesh": lambda path: _check_mesh(abfm.load_mesh(path)),
    "values": _values,
    "map": _map,
    "result": _result,
    "project": _project,
    "recent": _recent,
    "preferences": _preferences,
    "spec": _spec,
}

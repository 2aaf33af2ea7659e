"""The doors through which users open files, and what must hold of what comes in and is used a
little.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

import abfm
from abfm import AbfmError, Match, TriangleMesh
from abfm.errors import LONGEST
from abfm_viewer.document.document import THEMES
from abfm_viewer.files.autosave import recoverable
from abfm_viewer.files.origin import load_origin
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session import Session
from abfm_viewer.window.preferences import Preferences
from tests.attack.specimens import MESH, Door


class BrokenPromiseError(Exception):
    """What was opened is not what it should be, or the way in which it was refused."""


_INNER = re.compile(
    r"\b__\w+__\b|NoneType|object has no attribute|not subscriptable|unhashable|slice indices|No "
    r"module named|usecols"
    r"|invalid literal|could not convert|base 10|codec can't|set_int_max"
    r"|positional argument|\w+\(\) (argument|takes)|has no len|not iterable|unsupported "
    r"operand|<\w+ object"
)
"""Words that only programmers understand, unless they are the user's own."""


def enter(door: Door, path: Path) -> None:
    """Open a file as users do.

    An `AbfmError` is raised where the file is refused as it should be, a `BrokenPromiseError` where
    it came in though it should not have, or was refused in several lines; anything else is raised
    by what was attacked.
    """
    try:
        DOORS[door](path)
    except AbfmError as error:
        text = str(error)
        _hold(
            len(text.splitlines()) == 1,
            f"an error of {len(text.splitlines())} lines: {text[:300]!r}",
        )
        _hold(
            text.isprintable() or max(text) >= "\udc80",
            f"an error that cannot be printed: {text[:300]!r}",
        )
        given = path.read_bytes() if door == "spec" else b""
        inner = [
            words[0]
            for words in _INNER.finditer(text.replace(str(path), ""))
            if words[0].encode() not in given
        ]
        _hold(not inner, f"an error in the words of Python: {text[:300]!r}")
        _hold(len(text) <= LONGEST, f"an error of {len(text)} characters: {text[:300]!r}...")
        raise


def _hold(holds: bool | np.bool_, broken: str) -> None:
    if not holds:
        raise BrokenPromiseError(broken)


def _mesh(path: Path) -> None:
    _check_mesh(abfm.load_mesh(path))


def _check_mesh(mesh: TriangleMesh) -> None:
    V, F = len(mesh.vertices), len(mesh.faces)
    _hold(
        mesh.vertices.shape == (V, 3) and mesh.faces.shape == (F, 3) and V >= 3 and F >= 1,
        "a mesh of wrong shapes",
    )
    _hold(np.isfinite(mesh.vertices).all(), "a mesh with vertices that are not finite")
    _hold(
        mesh.faces.min() >= 0 and mesh.faces.max() < V,
        "a mesh with faces of vertices that are not there",
    )
    _hold(len(np.unique(mesh.faces)) == V, "a mesh with vertices that no face uses")
    _hold(
        mesh.vertex_ids.shape == (V,) and mesh.vertex_ids.max() < mesh.file_vertex_count,
        "a mesh of wrong numbers",
    )
    area = mesh.length_scale**2
    _hold(np.isfinite(area) and area > 0, f"a mesh of area {area}")
    for message in mesh.messages:
        _hold(
            len(message.splitlines()) == 1 and len(message) <= LONGEST,
            f"a message of a mesh: {message[:300]!r}",
        )


def _check_values(values: np.ndarray) -> None:
    _hold(
        values.shape == MESH.vertices.shape[:1] and values.dtype == np.float64,
        f"values of shape {values.shape}",
    )
    _hold(np.isfinite(values).all(), "values that are not finite")


def _values(path: Path) -> None:
    column = ",column=0" if path.name.startswith("two") or path.suffix == ".csv" else ""
    _check_values(abfm.function(MESH, f'file:"{path}"{column}'))


def _map(path: Path) -> None:
    target = abfm.functions.vertex_map(MESH, str(path))
    V = len(MESH.vertices)
    _hold(
        target.shape == (V,) and target.dtype.kind == "i",
        f"a map of shape {target.shape} and type {target.dtype}",
    )
    _hold(target.min() >= 0 and target.max() < V, "a map to vertices that are not there")


def _result(path: Path) -> None:
    match = abfm.load_match(path)
    _check_match(match)
    match.save(path.with_name("again.npz"))
    _hold(
        abfm.load_match(path.with_name("again.npz")).mismatch == match.mismatch,
        "a result that changes when saved",
    )
    _hold(
        np.isfinite(match.advect(match.parameters.tau / 2)).all(),
        "a result that carries to what is not finite",
    )


def _check_match(match: Match) -> None:
    mesh = match.mesh
    _check_mesh(mesh)
    V, F, C = len(mesh.vertices), len(mesh.faces), len(match.weights)
    for name in ("source", "target", "advected"):
        values = getattr(match, name)
        _hold(
            values.shape == (V, C) and np.isfinite(values).all(),
            f"a result whose {name} has shape {values.shape}",
        )
    _hold(
        match.velocity.ndim == 3 and match.velocity.shape[1:] == (F, 3),
        "a result with a field of a wrong shape",
    )
    _hold(np.isfinite(match.velocity).all(), "a result with a field that is not finite")
    _hold(
        (match.weights >= 0).all() and (match.mask is None or (match.mask >= 0).all()),
        "a result of negative weights",
    )
    _hold(len(match.energy_history) == len(match.stages), "a result with a history of two lengths")
    _hold(0 <= match.mismatch < np.inf, f"a result with the mismatch {match.mismatch}")
    _hold(
        match.verdict.kind != "" and isinstance(match.stop_reason, str),
        "a result without a verdict",
    )


def _project(path: Path) -> None:
    document, known = load_project(path)
    load_origin(path)
    recoverable(StateFolder(path.parent))
    _check_mesh(document.surface().mesh)
    if document.result is not None:
        _check_match(document.result)
    for values in known.values():
        _check_values_of(document.surface().mesh, values)
    _hold(
        np.isfinite([document.time, document.parameters.tau]).all(),
        "a project with times that are not finite",
    )
    again = path.with_name("again.abfm")
    save_project(again, document, known)
    _hold(load_project(again)[0].channels == document.channels, "a project that changes when saved")
    session = _session()
    session.restore(document, known, None)
    session.reset_history()
    session.update()
    is_there = session.document.identity is document.identity
    _hold(is_there, "a project that is not there when it was opened")


def _check_values_of(mesh: TriangleMesh, values: np.ndarray) -> None:
    _hold(
        values.shape == mesh.vertices.shape[:1] and np.isfinite(values).all(),
        "a project with wrong known values",
    )


def _recent(path: Path) -> None:
    state = StateFolder(path.parent)
    _hold(
        all(isinstance(known, Path) for known in state.recent()), "recent files that are no paths"
    )
    was_file = path.is_file() and not path.is_symlink()
    state.add_recent(path)
    _hold(path in state.recent() or not was_file, "a recent file is forgotten")


@cache
def _session() -> Session:
    return Session(MESH, "ball", at_once=True)


def _preferences(path: Path) -> None:
    state = StateFolder(path.parent)
    Preferences(_session(), state)
    view = _session().view
    _hold(
        view.theme in THEMES and 0.5 <= view.ui_scale <= 4,
        f"the preferences {view.theme} and {view.ui_scale}",
    )
    was_file = path.is_file() and not path.is_symlink()
    state.set_preference("theme", "dark")
    _hold(state.preferences().get("theme") == "dark" or not was_file, "a preference is forgotten")


def _spec(path: Path) -> None:
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    parsed = abfm.functions.parse(text)
    _hold(
        abfm.functions.parse(str(parsed)) == parsed,
        f"a function whose text {str(parsed)[:200]!r} means another",
    )
    _check_values(abfm.function(MESH, text))


DOORS: dict[Door, Callable[[Path], None]] = {
    "mesh": _mesh,
    "values": _values,
    "map": _map,
    "result": _result,
    "project": _project,
    "recent": _recent,
    "preferences": _preferences,
    "spec": _spec,
}

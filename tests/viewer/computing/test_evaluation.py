"""Functions computed in a subprocess: values and errors are those computed in this process."""

import warnings

import numpy as np
import pytest

from abfm import AbfmError, FunctionError, TriangleMesh, function
from abfm.workers.progress import reporting_steps
from abfm_viewer.computing import evaluation
from abfm_viewer.computing.defaults import default_functions
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.session.notices import Notices
from abfm_viewer.window.library_warnings import LibraryWarnings
from tests.messages import check_message, raises
from tests.shapes import icosphere, with_loose_vertex

SPARSE = with_loose_vertex(icosphere(2))


@pytest.fixture(scope="module")
def in_subprocess():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", 0)
        functions = Functions(SPARSE)
    yield functions
    functions.retire()


@pytest.mark.parametrize(
    "spec", ["gaussian:vertex=7,width=0.2", "eigenfunction:3", "coordinate:x + geodesic:vertex=0"]
)
def test_subprocess_values_are_the_same(in_subprocess, spec):
    np.testing.assert_array_equal(in_subprocess.evaluate(spec), function(SPARSE, spec))
    assert in_subprocess._worker.pid
    assert in_subprocess.defaults() == default_functions(SPARSE)


def test_subprocess_warnings_are_the_same(monkeypatch, tmp_path):
    """Values that differ between copies of a vertex cause a warning, which becomes a card."""
    monkeypatch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", 0)
    sphere = icosphere(1)
    corners = np.arange(sphere.faces.size)
    split = TriangleMesh(sphere.vertices[sphere.faces.ravel()], corners.reshape(-1, 3), merge=True)
    np.save(tmp_path / "x.npy", corners)
    functions, shown = Functions(split), Notices(lambda: 0)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        collected = LibraryWarnings()
        functions.evaluate(f"file:{tmp_path / 'x.npy'}")
        collected.update(shown)
        collected.close()
    functions.retire()
    check_message(shown.cards[0].text, 198)


@pytest.mark.parametrize("spec", ["gaussian:vertex=5", "nonsense", "file:not there.npy"])
def test_subprocess_errors_are_the_same(in_subprocess, spec):
    with pytest.raises(FunctionError) as here:
        function(SPARSE, spec)
    with pytest.raises(FunctionError) as there:
        in_subprocess.evaluate(spec)
    assert str(there.value) == str(here.value)


def test_only_large_meshes_have_a_process(monkeypatch):
    assert evaluation.SUBPROCESS_VERTICES_MIN == 20_000
    monkeypatch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", len(SPARSE.vertices))
    for mesh, has_one in ((icosphere(1), False), (SPARSE, True)):
        functions = Functions(mesh)
        functions.evaluate("coordinate:x")
        assert (functions._worker is not None and functions._worker.pid is not None) == has_one
        functions.retire()
    monkeypatch.setattr(evaluation, "_EXACT_VERTICES_MIN", 0)
    monkeypatch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", 1_000)
    functions = Functions(SPARSE)
    for spec, has_one in (("coordinate:x", False), ("geodesic:vertex=3", True)):
        steps = []
        with reporting_steps(lambda step, steps=steps: steps.append(step and step.task)):
            functions.evaluate(spec)
        assert ("in a subprocess" in steps) == has_one
        assert (functions._worker.pid is not None) == has_one
    functions.retire()
    monkeypatch.setattr(evaluation, "SUBPROCESS_VERTICES_MIN", 0)
    closed = Functions(SPARSE)
    closed.retire()
    with raises(AbfmError):
        closed.evaluate("coordinate:x")
    assert closed._worker.pid is None

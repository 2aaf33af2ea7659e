"""What importing costs: names are there at once, what computes them comes when they are used."""

from __future__ import annotations

import pkgutil
import subprocess
import sys

import pytest

import abfm

HEAVY = {"numba", "scipy", "igl", "cholespy", "potpourri3d", "pyevtk", "trimesh", "nibabel"}


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize(
    "code",
    [
        "import abfm; abfm.TriangleMesh, abfm.load_mesh, abfm.Parameters",
        "from abfm import AbfmError, Parameters, TriangleMesh, load_mesh",
        "from abfm.assets import asset_path; from abfm.mesh import load_mesh; load_mesh(asset_path('human_A.off'))",
        "import abfm_viewer.app, abfm_viewer.cli, abfm_viewer.scene.opengl, abfm_viewer.scene.camera",
    ],
)
def test_reading_and_drawing_a_mesh_loads_no_solver(code):
    assert HEAVY & set(python(f"import sys; {code}; print(*sys.modules)").split()) == set()


@pytest.mark.parametrize(
    "code",
    [
        "import abfm.matching.result",
        "from abfm.matching.result import Match",
        "from abfm import matching",
        "import abfm.matching.match, abfm.matching.result",
        "from abfm import match, matching",
        "import abfm.functions, abfm.flow.advection",
    ],
)
def test_public_names_are_what_they_were_whatever_is_imported_first(code):
    told = python(f"{code}; import abfm; print(*(getattr(abfm, name).__qualname__ for name in abfm.__all__))")
    assert told.split() == abfm.__all__


def test_no_submodule_takes_a_public_name():
    assert {module.name for module in pkgutil.iter_modules(abfm.__path__)} & set(abfm.__all__) == set()


def test_every_public_name_is_listed_and_others_are_refused():
    assert set(abfm.__all__) <= set(dir(abfm))
    with pytest.raises(AttributeError, match="module 'abfm' has no attribute 'macth'"):
        _ = abfm.macth
    with pytest.raises(ImportError, match="cannot import name 'macth'"):
        from abfm import macth  # noqa: F401

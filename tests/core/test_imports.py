"""What importing costs: names are there at once, what computes them comes when they are used."""

from __future__ import annotations

import inspect
import json
import pkgutil
import subprocess
import sys
from functools import cache
from importlib import import_module

import pytest

import abfm

HEAVY = {"numba", "scipy", "igl", "cholespy", "potpourri3d", "pyevtk", "trimesh", "nibabel"}

FRONTS = [
    "abfm",
    *(f"abfm.{room.name}" for room in pkgutil.iter_modules(abfm.__path__) if room.ispkg and room.name != "numerics"),
]


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize(
    "code",
    [
        "from abfm import AbfmError, Parameters, TriangleMesh, load_mesh; from abfm.assets import asset_path; "
        "load_mesh(asset_path('human_A.off'))",
        "import abfm_viewer.app, abfm_viewer.cli, abfm_viewer.scene.opengl, abfm_viewer.scene.camera; "
        "import abfm_viewer.window.window, abfm_viewer.window.open_window",
    ],
)
def test_reading_and_drawing_a_mesh_loads_no_solver(code):
    assert HEAVY & set(python(f"import sys; {code}; print(*sys.modules)").split()) == set()


CODES = [
    "import abfm.matching.result",
    "from abfm.matching.result import Match",
    "from abfm import matching",
    "import abfm.matching.match, abfm.matching.result",
    "from abfm import match, matching",
    "import abfm.functions, abfm.flow.advection",
    "import abfm.flow.flow_lines, abfm.calculus.helmholtz_hodge, abfm.baselines.linear_blend, abfm.maps.folds",
]
_PUBLIC_NAMES = f"""
import importlib, inspect, json, os
import numba, scipy.sparse.linalg, scipy.spatial, trimesh  # what others wrote and takes long is loaded once

def apart(work, *given):
    if (child := os.fork()) == 0:
        work(*given)
        os._exit(0)
    os.waitpid(child, 0)

def of_all_rooms(code):
    exec(code)
    for name in {FRONTS}:
        apart(of_one, code, name)

def of_one(code, name):
    front = importlib.import_module(name)
    found = [public for public in front.__all__ if not inspect.ismodule(getattr(front, public))]
    print(json.dumps([code, name, found]), flush=True)

for code in {CODES}:
    apart(of_all_rooms, code)
"""


@cache
def public_names() -> dict[tuple[str, str], list[str]]:
    """Those that are no modules, by code and room: of processes in which nothing but the code ran before."""
    told = map(json.loads, python(_PUBLIC_NAMES).splitlines())
    return {(code, front): names for code, front, names in told}


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("front", FRONTS)
def test_public_names_are_no_modules_whatever_is_imported_first(front, code):
    """Some have the name of the file that they are in; the rooms themselves are packages."""
    rooms = {module.name for module in pkgutil.iter_modules(import_module(front).__path__) if module.ispkg}
    assert public_names()[code, front] == [name for name in import_module(front).__all__ if name not in rooms]


def test_every_public_name_is_listed_and_others_are_refused():
    assert set(abfm.__all__) <= set(dir(abfm))
    for name in abfm.__all__:
        found = getattr(abfm, name)
        assert (found.__name__.removeprefix("abfm.") if inspect.ismodule(found) else found.__qualname__) == name
    with pytest.raises(AttributeError, match="macth"):
        _ = abfm.macth
    with pytest.raises(ImportError, match="cannot import name 'macth'"):
        exec("from abfm import macth")


def test_importing_all_names_takes_those_of_no_other_modules() -> None:
    code = "import io; from abfm import *; print(io.StringIO('text').read(), match is not None, 'flow' in globals())"
    assert python(code) == "text True False"

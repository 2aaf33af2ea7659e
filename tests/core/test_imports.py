import inspect
import json
import pkgutil
from importlib import import_module
from itertools import product

import pytest

import abfm
from tests.processes import python

HEAVY = {"numba", "scipy", "igl", "cholespy", "potpourri3d", "pyevtk", "trimesh"}
HEAVY |= {"nibabel", "nilearn"}

FRONTS = [
    "abfm",
    *(
        f"abfm.{package.name}"
        for package in pkgutil.iter_modules(abfm.__path__)
        if package.ispkg and package.name not in ("numerics", "workers")
    ),
]


@pytest.mark.parametrize(
    "code",
    [
        "from abfm import AbfmError, Parameters, TriangleMesh, load_mesh; from abfm.assets import "
        "asset_path; "
        "load_mesh(asset_path('human_A.off'))",
        "import abfm_viewer.app, abfm_viewer.cli, abfm_viewer.scene.opengl, "
        "abfm_viewer.scene.surfaces; "
        "import abfm_viewer.window.window",
    ],
)
def test_reading_and_drawing_a_mesh_loads_no_solver(code):
    done = python(f"import sys; {code}; print(*sys.modules)", check=True)
    assert HEAVY & set(done.stdout.split()) == set()


CODES = [
    "import abfm.matching.problem",
    "from abfm.matching.result import Match",
    "from abfm import matching",
    "import abfm.matching.match, abfm.matching.problem",
    "from abfm import match, matching",
    "import abfm.functions, abfm.flow.advection",
    "import abfm.flow.flow_lines, abfm.calculus.eigenbasis, abfm.baselines.interpolation",
]
_PUBLIC_NAMES = f"""
import importlib, inspect, json, os
# slow dependencies are imported once
import numba, scipy.sparse.linalg, scipy.spatial, trimesh

for code in {CODES}:
    if os.fork() == 0:
        exec(code)
        for name in {FRONTS}:
            front = importlib.import_module(name)
            found = [one for one in front.__all__ if not inspect.ismodule(getattr(front, one))]
            print(json.dumps([code, name, found]), flush=True)
        os._exit(0)
    os.wait()
"""


def test_public_names_are_not_modules():
    """A public name like its module's is never replaced by the module, in any import order."""
    lines = [json.loads(line) for line in python(_PUBLIC_NAMES, check=True).stdout.splitlines()]
    assert [(code, front) for code, front, _ in lines] == list(product(CODES, FRONTS))
    for code, name, names in lines:
        front = import_module(name)
        packages = {
            package.name for package in pkgutil.iter_modules(front.__path__) if package.ispkg
        }
        assert names == [public for public in front.__all__ if public not in packages], code


PUBLIC_NAMES = [
    *("load", "load_mesh", "TriangleMesh", "function", "Parameters", "Problem", "match"),
    *("Match", "register", "Registration", "Correspondence", "PointMap", "sequence"),
    *("Sequence", "register_population", "Population", "solve_many", "advect", "Flow"),
    *("MatchingEnergy", "Monitor", "AbfmError", "AdvectionError", "FunctionError"),
    *("MeshError", "ParameterError", "ResultError"),
]
PUBLIC_PACKAGES = [
    *("baselines", "batch", "calculus", "experiments", "flow", "functions", "io", "maps"),
    *("matching", "mesh", "outcome", "pages", "parameters", "population", "registration"),
    *("sequences", "streaks", "tasks", "workers"),
]


def test_public_names_equal_the_list():
    assert sorted(abfm.__all__) == sorted(PUBLIC_NAMES)
    assert sorted(dir(abfm)) == sorted(PUBLIC_NAMES + PUBLIC_PACKAGES)


def test_unknown_names_are_refused():
    assert set(abfm.__all__) <= set(dir(abfm))
    for name in abfm.__all__:
        found = getattr(abfm, name)
        own = found.__name__ if inspect.ismodule(found) else found.__qualname__
        assert own.removeprefix("abfm.") == name
    with pytest.raises(AttributeError, match="macth"):
        _ = abfm.macth
    with pytest.raises(ImportError, match="cannot import name 'macth'"):
        exec("from abfm import macth")


def test_star_import_does_not_replace_modules():
    code = (
        "import io; from abfm import *; print(io.StringIO('text').read(), match is not None, "
        "'flow' in globals())"
    )
    assert python(code).stdout == "text True False\n"

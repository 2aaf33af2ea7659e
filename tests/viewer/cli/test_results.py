"""Steps of a path: told by `abfm info`, written by `abfm match`, picked by their distortion."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from abfm import Parameters, PathStep, load, match
from abfm.assets import asset_path
from abfm.functions import function
from abfm.matching.path import COLUMNS
from abfm.mesh import load_mesh

EIGHT = str(asset_path("eight.off"))
PAIR = [f"gaussian:vertex={vertex},width=0.2" for vertex in (10, 40)]
WORDS = [
    "match",
    EIGHT,
    f"--source={PAIR[0]}",
    f"--target={PAIR[1]}",
    "--set=iterations=6",
    "--quiet",
    "--out",
]
SHORT = 3  # the exit status of a run that is too short to arrive


@pytest.fixture(scope="module")
def found():
    """A match that is the last of three steps, the second on the subdivision, areas 1, 3 and 2."""
    mesh = load_mesh(EIGHT)
    alone = match(
        mesh, *(function(mesh, each) for each in PAIR), Parameters.of(iterations=4, refine=0)
    )
    own = replace(alone.path[alone.step], log2_area=2.0)
    first = PathStep(1.0, 0.1, 0.3, 0.5 * own.velocity, 0.9, 0.9, 0.0, 1.0, 0.2)
    fine = replace(first, velocity=np.repeat(first.velocity, 4, axis=1), log2_area=3.0)
    fine = replace(fine, verified_residual=math.nan, folded=math.nan)
    return replace(alone, path=(first, fine, own), step=2)


def test_info_shows_the_path_of_a_result_with_the_step_that_it_is(found, tmp_path, abfm):
    out = tmp_path / "m.npz"
    for step in (1, 2):
        found.at_step(step).save(out)
        lines = abfm("info", out).out.splitlines()
        table = [line for line in lines if line.split()[:1] in (["1"], ["2"], ["3"], ["*"])]
        assert [line.startswith("*") for line in table] == [number == step for number in range(3)]
        assert [line.split()[-1] for line in table] == ["0", "1", "0"]
    assert lines[0].startswith(f"{out}: ")
    told = json.loads(abfm("info", out, "--json").out)
    assert (told["step"], told["refined"], told["path"][1]["verified_residual"]) == (2, 0, None)
    assert [told["path"][1][name] for name in ("sigma", "refined")] == [1.0, 1]


def test_match_writes_its_path_and_takes_the_step_that_is_asked_for(tmp_path, abfm):
    out, table = tmp_path / "m.npz", tmp_path / "p.csv"
    told = abfm(*WORDS, out, "--path", table, "--max-distortion", "1000", status=SHORT)
    header, *rows = csv.reader(table.read_text().splitlines())
    written = load(out)
    assert tuple(header) == COLUMNS
    assert len(rows) == len(written.path)
    assert 0 <= written.step < len(rows)
    assert f"; wrote {out}, {table}" in told.out
    assert "within distortion 1000" in told.out
    words = (*WORDS, out, "--max-distortion", "1e-9", "--json")
    numbers = json.loads(abfm(*words, status=SHORT).out)
    assert numbers["max_distortion"] == 1e-9
    assert 0.99 <= numbers["share_within"] <= 1
    assert numbers["worse_residual"] <= numbers["initial_residual"] * (1 + 1e-9)
    assert "1e-09" in numbers["headline"]
    told = json.loads(
        abfm(
            *WORDS, out, "--sigma", "2", "--goal", "0.2", "--refine", "auto", "--json", status=SHORT
        ).out
    )
    parameters = told["parameters"]
    assert [parameters[name] for name in ("sigma", "goal", "refine")] == [2.0, 0.2, None]
    assert "max_distortion" not in told

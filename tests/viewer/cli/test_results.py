import json
import math
from dataclasses import replace

import numpy as np

from abfm import Parameters, load_mesh, match
from abfm.functions import function
from abfm.matching import PathStep
from tests.viewer.cli.conftest import MESHES


def test_info_marks_the_selected_step(tmp_path, abfm):
    """The selected step is the second of three, on a subdivided mesh, or the third."""
    mesh, out = load_mesh(MESHES["eight"]), tmp_path / "m.npz"
    functions = (function(mesh, f"gaussian:vertex={vertex},width=0.2") for vertex in (10, 40))
    alone = match(mesh, *functions, Parameters.of(iterations=4, refine=0))
    own = replace(alone.path[alone.step], log2_area=2.0)
    first = PathStep(1.0, 0.1, 0.3, 0.5 * own.velocity, 0.9, 0.9, 0.0, 1.0, 0.2)
    fine = replace(first, velocity=np.repeat(first.velocity, 4, axis=1), log2_area=3.0)
    fine = replace(fine, verified_residual=math.nan, folded=math.nan)
    found = replace(alone, path=(first, fine, own), step=2)
    for step in (1, 2):
        found.at_step(step).save(out)
        lines = abfm("info {t}/m.npz").out.splitlines()
        table = [line for line in lines if line.split()[:1] in (["1"], ["2"], ["3"], ["*"])]
        assert [line.startswith("*") for line in table] == [number == step for number in range(3)]
        assert [line.split()[-1] for line in table] == ["0", "1", "0"]
    assert lines[0].startswith(f"{out}: ")
    facts = json.loads(abfm("info {t}/m.npz --json").out)
    assert (facts["step"], facts["refined"], facts["path"][1]["verified_residual"]) == (2, 0, None)
    assert [facts["path"][1][name] for name in ("sigma", "refined")] == [1.0, 1]

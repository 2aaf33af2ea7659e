"""Figure 2: advection agrees with flow lines, the better the finer the mesh."""

from __future__ import annotations

import numpy as np

from abfm.experiments.figure_02 import FUNCTION, MAP, differences
from abfm.flow.flow import Flow
from abfm.functions import function
from abfm.sheets import Panel
from tests.core.experiments.small import ran, run, values
from tests.shapes import open_cylinder, torus


def test_differences_grow_with_time() -> None:
    quarter, half, whole = (
        value for name, value in values(ran(2)[1]).items() if name.startswith("advected function")
    )
    assert 0 < quarter < half < whole < 0.3


def test_differences_fall_under_refinement() -> None:
    found = values(ran(2)[1])
    orders = [value for name, value in found.items() if name.startswith("order")]
    assert len(orders) == 2
    assert min(orders) > 1
    coarse, fine = (value for name, value in found.items() if "exact solution" in name)
    assert fine < coarse / 2.5


def test_without_motion_there_is_no_difference() -> None:
    mesh = torus(12, 8)
    flow = Flow(mesh, np.zeros((len(mesh.faces), 3)))
    still = differences(flow, function(mesh, "coordinate:x"), np.array([0.5, 1.0]))
    assert np.abs(still[FUNCTION]).max() < 1e-12
    assert np.abs(still[MAP]).max() < 1e-12


def test_on_another_mesh_with_a_boundary() -> None:
    mesh = open_cylinder(24, 12)
    example, findings = run(2, mesh)
    assert example.problem.mesh is mesh
    last = findings.sheet.rows[0][-1]
    assert isinstance(last, Panel)
    assert all(line.shape[1] == 3 and len(line) > 1 for line in last.lines)

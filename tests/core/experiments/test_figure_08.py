"""Figure 8: the field behind the target is found again."""

from __future__ import annotations

import numpy as np

from abfm.calculus.operators import gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.experiments.figure_08 import EXPERIMENT, seen_rate
from abfm.flow.advection import advect
from tests.core.experiments.small import quiet, ran
from tests.shapes import open_cylinder, torus


def test_field_is_found() -> None:
    _, findings = ran(8)
    along, share, seen, whole, largest, mismatch, *witnesses = (measure.value for measure in findings.measures)
    assert along < 0.1
    assert 0.1 < share < 1
    assert seen < 0.1
    assert seen < whole
    assert largest < 0.02
    assert mismatch < 0.02
    assert max(witnesses) < 0.1  # by flow lines, on the subdivided mesh; folded faces


def test_target_is_the_source_carried_by_the_field() -> None:
    setup = EXPERIMENT.set_up(torus(24, 12), True)
    carried = advect(setup.mesh, setup.hidden.velocity[0], setup.source, setup.parameters.tau)
    np.testing.assert_array_equal(setup.target, carried)
    assert np.abs(setup.target - setup.source).max() > 0.3
    assert setup.flow is None


def test_motion_along_level_lines_is_not_seen() -> None:
    mesh = torus(24, 12)
    f = mesh.vertices[:, 2]
    slope = to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
    normals = np.cross(*np.moveaxis(np.diff(mesh.vertices[mesh.faces], axis=1), 1, 0))
    assert seen_rate(mesh, np.cross(normals, slope), f[None]) < 1e-12
    assert seen_rate(mesh, slope, f[None]) > 0.1


def test_on_another_mesh_with_a_boundary() -> None:
    findings = EXPERIMENT.run(EXPERIMENT.set_up(open_cylinder(24, 12), True), quiet)
    assert all(np.isfinite(measure.to_dict()["value"]) for measure in findings.measures)

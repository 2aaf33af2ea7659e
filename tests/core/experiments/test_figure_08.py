"""Figure 8: the field behind the target is found again."""

from __future__ import annotations

import numpy as np

from abfm.calculus.operators import gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.experiments.figure_08 import seen_rate
from tests.core.experiments.small import ran, run, stated
from tests.shapes import open_cylinder, torus


def test_field_is_found() -> None:
    _, findings = ran(8)
    along, share, seen, whole, largest, mismatch, *witnesses = (
        measure.value for measure in findings.measures
    )
    assert along < 0.1
    assert 0.1 < share < 1
    assert seen < 0.1
    assert seen < whole
    assert largest < 0.02
    assert mismatch < 0.02
    assert max(witnesses) < 0.1  # by flow lines, on the subdivided mesh; folded faces


def test_the_field_that_made_the_target_is_not_told() -> None:
    example = stated(8, torus(24, 12))
    assert np.abs(example.problem.target - example.problem.source).max() > 0.3
    assert example.flow is None


def test_motion_along_level_lines_is_not_seen() -> None:
    mesh = torus(24, 12)
    f = mesh.vertices[:, 2]
    slope = to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
    normals = np.cross(*np.moveaxis(np.diff(mesh.vertices[mesh.faces], axis=1), 1, 0))
    assert seen_rate(mesh, np.cross(normals, slope), f[None]) < 1e-12
    assert seen_rate(mesh, slope, f[None]) > 0.1


def test_on_another_mesh_with_a_boundary() -> None:
    assert run(8, open_cylinder(24, 12))[1].measures

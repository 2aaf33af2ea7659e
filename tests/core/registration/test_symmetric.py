"""Symmetric registration: the mean of the maps in both directions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm import load
from abfm.batch import Row
from abfm.errors import ParameterError
from abfm.io import write_surface
from abfm.mesh.shapes import sphere
from abfm.registration.symmetric import SymmetricRegistration
from abfm.tasks import Monitor
from tests.messages import raises

MESH = sphere(2)
BRIEF = {"refine": 0, "iterations": 20}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Return columns of a table: two spheres with bumps at slightly different positions."""
    folder = tmp_path_factory.mktemp("symmetric")
    for name, move in (("a", 0.0), ("b", 0.15)):
        write_surface(folder / f"{name}.ply", MESH)
        x, y, z = MESH.vertices.T
        bump = np.exp(-((x - move) ** 2 + y**2) / 0.2) * (z > 0)
        np.save(folder / f"{name}.npy", bump + 0.3 * np.sin(3 * y))
    files = {side: folder / f"{side}.ply" for side in "ab"}
    functions = {"source": f"file:{folder}/a.npy", "target": f"file:{folder}/b.npy"}
    return {**files, **functions, "initial": "connectivity", **BRIEF}


def solve(inputs):
    return Row("s", {"task": "symmetric", **inputs}).task().solve(Monitor())


@pytest.fixture(scope="module")
def found(inputs):
    return solve(inputs)


def test_exchanged_surfaces_give_the_inverse_map(inputs, found):
    other = dict(inputs, a=inputs["b"], b=inputs["a"])
    other |= {"source": inputs["target"], "target": inputs["source"]}
    exchanged = solve(other)
    assert_allclose(exchanged.points.positions, found.back.positions, atol=1e-12)
    assert_allclose(exchanged.back.positions, found.points.positions, atol=1e-12)
    assert exchanged.facts.outcome is found.facts.outcome


def test_mean_lies_between_both_maps(inputs, tmp_path):
    task = Row("s", {"task": "symmetric", **inputs}).task()
    forward, backward = task.forward.solve(Monitor()), task.backward.solve(Monitor())
    mean = SymmetricRegistration.average(forward, backward)
    ends = forward.points.positions, backward.back.positions
    distances = np.linalg.norm(ends[0] - ends[1], axis=1)
    for end in ends:
        # the midpoint of a chord is closer to the sphere than the ends of the chord to each other
        assert (np.linalg.norm(mean.points.positions - end, axis=1) <= distances + 1e-12).all()
    assert_allclose(mean.asymmetry * MESH.length_scale, distances)
    mean.save(tmp_path / "s.npz")
    assert_array_equal(load(tmp_path / "s.npz").asymmetry, mean.asymmetry)
    assert mean.facts.outcome.rank == max(each.facts.outcome.rank for each in (forward, backward))


@pytest.mark.parametrize("initial", ["file:map.txt", "sphere:a.ply,b.ply"])
def test_initial_maps_of_one_direction_are_refused(inputs, initial):
    with raises(ParameterError, "initial", recorded=False):  # the printed path may be abbreviated
        Row("s", {"task": "symmetric", **inputs, "initial": initial})


def test_unknown_kinds_of_tasks_are_refused(inputs):
    with raises(ParameterError, "task", "both", "symmetric"):
        Row("s", {"task": "both", **inputs})

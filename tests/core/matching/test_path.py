import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm import MatchingEnergy, Parameters, ResultError, load, match
from abfm.io import load_arrays, save_arrays
from abfm.matching import PathStep, path_table
from abfm.matching.path import COLUMNS, as_stored
from abfm.matching.result import match_of
from abfm.matching.solving.measures import flow_line_measures
from tests.core.fields import bump
from tests.messages import check_message
from tests.shapes import icosphere, square

MESH = icosphere(2)
FACES = len(MESH.faces)


@pytest.fixture(scope="module")
def found():
    one, other = bump(MESH, MESH.vertices[3], 0.3), bump(MESH, MESH.vertices[20], 0.3)
    return match(MESH, one, other, Parameters.of(iterations=30, refine=0))


@pytest.fixture(scope="module")
def longer(found):
    """Return the match with two more steps before its own; one is on the subdivision."""
    half = PathStep(1.0, 0.1, 0.3, 0.5 * found.velocity, 0.4, 0.45, 0.0, 0.1, 0.2)
    fine = replace(half, velocity=np.repeat(half.velocity, 4, axis=1), verified_residual=math.nan)
    return replace(found, path=(half, fine, found.path[found.step]), step=2)


def test_distortion_of_known_flows_is_exact():
    sphere = icosphere(4)
    energy = MatchingEnergy(sphere, *(bump(sphere, sphere.vertices[i], 0.3) for i in (0, 1)))
    centres = sphere.normalized().vertices[sphere.faces].mean(axis=1)
    unmoved = flow_line_measures(energy, np.zeros((1, len(sphere.faces), 3)))
    expected = energy.residual(energy.functions.source)
    assert unmoved["verified_residual"] == pytest.approx(expected, rel=1e-6)
    turned = flow_line_measures(energy, np.cross([0, 0, 1.0], centres)[None])
    for measures in (unmoved, turned):
        assert measures["folded"] == 0
        assert measures["log2_area"] < 4e-3
        assert measures["log2_shape"] < 8e-3
    flat = square(16)
    plane = MatchingEnergy(flat, *(bump(flat, flat.vertices[i], 0.3) for i in (130, 140)))
    wide = plane.mesh.vertices[plane.mesh.faces].mean(axis=1)
    outward = wide - plane.mesh.vertices.mean(axis=0)
    measures = flow_line_measures(plane, 0.5 * outward[None])
    assert measures["log2_area"] == pytest.approx(math.log2(math.e), rel=0.03)
    assert measures["log2_shape"] < 0.04


def test_path_contains_the_match(found, longer):
    step = found.path[found.step]
    assert step.velocity is found.velocity
    for name in ("residual", "verified_residual", "folded"):
        assert getattr(step, name) == getattr(found, name)
    assert step.alpha == found.parameters.alpha
    assert step.log2_area > 0 < step.log2_shape
    assert found.at_step(found.step) is found
    alone = replace(found, path=(), step=0)
    assert alone.path[0].residual == found.residual
    assert math.isnan(alone.path[0].log2_area)
    earlier = longer.at_step(0)
    assert (earlier.step, earlier.residual, earlier.path) == (0, 0.4, longer.path)
    assert_allclose(earlier.advected, found.push(found.source, 0.5), atol=1e-6)
    assert earlier.verdict.kind == "not reached"
    assert earlier.at_step(2).verdict.kind == found.verdict.kind


def test_path_table_is_csv(longer):
    header, *rows = csv.reader(path_table(longer.path, MESH))
    assert tuple(header) == COLUMNS
    assert [row[-1] for row in rows] == ["0", "1", "0"]
    assert rows[0][:5] == ["1", "0.1", "0.3", "0.4", "0.45"]
    assert rows[1][4] == "nan"


def test_file_without_a_path_has_one_step(longer, tmp_path):
    path = tmp_path / "m.npz"
    longer.save(path)
    arrays = load_arrays(path)
    save_arrays(path, {name: array for name, array in arrays.items() if "path" not in name})
    [step] = load(path).path
    assert (step.residual, step.velocity.shape) == (longer.residual, longer.velocity.shape)


@pytest.mark.parametrize("seed", range(8))
def test_path_survives_saving(seed, found, tmp_path):
    random = np.random.default_rng(seed)
    steps = []
    for _ in range(random.integers(1, 5)):
        count, times = random.integers(1, 4), random.integers(0, 3)
        fields = np.repeat(found.velocity, count, axis=0) * random.uniform(0, 1, (count, 1, 1))
        steps.append(replace(found.path[found.step], velocity=np.repeat(fields, 4**times, axis=1)))
    selected = int(random.integers(len(steps)))
    one = replace(found, fine_velocity=steps[selected].velocity, path=tuple(steps), step=selected)
    one.save(path := tmp_path / "m.npz")
    arrays = load_arrays(path)
    loaded = match_of(MESH, arrays)
    assert loaded.step == selected
    for number, (given, read) in enumerate(zip(steps, loaded.path, strict=True)):
        same = given.velocity if number == selected else as_stored(given.velocity, MESH)
        assert_array_equal(read.velocity, same)
        assert path_table([read], MESH) == path_table([given], MESH)
    loaded.save(again := tmp_path / "again.npz")
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda counts: counts + 1, "step 1 is 3 in path_fields, but the step has 2"),
        (lambda counts: counts[::-1], "step 1 is 1 in path_fields, but the step has 2"),
        (lambda counts: counts[:1], "path_fields has shape (1,); expected (2)"),
        (lambda counts: np.array([7, 2]), "path_velocity has shape"),
        (lambda counts: 0 * counts, "path_fields has the value 0"),
    ],
)
def test_damaged_numbers_of_fields_are_refused(damage, expected, found, tmp_path):
    selected = replace(found.path[found.step], velocity=np.repeat(found.velocity, 2, axis=0))
    path = found.path[found.step], selected
    replace(found, fine_velocity=selected.velocity, path=path, step=1).save(tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz") as file:
        arrays = dict(file)
    arrays["path_fields"] = damage(arrays["path_fields"])
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises(ResultError) as error:
        load(tmp_path / "m.npz")
    assert expected in str(error.value)


@pytest.mark.parametrize(
    ("name", "damage", "named"),
    [
        ("path_step", lambda selected: selected + 7, ("path_step", 9, 3)),
        ("path_step", None, ("path_step",)),
        ("path_steps", None, ("path_steps",)),
        ("path_steps", lambda rows: rows[:2], ("path_step", 2)),
        ("path_steps", lambda rows: rows + 0.5, ()),
        ("path_steps", lambda rows: rows * 1e300, ()),
        ("path_steps", lambda rows: np.roll(rows, 1, axis=0), (1, 0)),
        ("path_velocity", None, (f"(1, {5 * FACES}, 3)",)),
        ("path_velocity", lambda fields: fields[:, 1:], (f"(1, {5 * FACES}, 3)",)),
        ("path_velocity", lambda fields: fields * np.nan, ("path_velocity",)),
    ],
)
def test_damaged_path_is_refused_in_one_line(longer, tmp_path, name, damage, named):
    path = tmp_path / "m.npz"
    longer.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    given = arrays.pop(name)
    np.savez(path, **arrays, **({name: damage(given)} if damage else {}))
    with pytest.raises(ResultError) as error:
        load(path)
    check_message(str(error.value), *named)
    assert "\n" not in str(error.value)


def test_match_with_a_diverged_step_can_be_saved(found, tmp_path):
    """Infinite measurements of a step are stored as NaN."""
    wild = PathStep(1.0, 0.1, 0.3, 2 * found.velocity, math.inf, math.inf, 0.5, math.inf, 0.2)
    replace(found, path=(wild, found.path[found.step]), step=1).save(tmp_path / "m.npz")
    again = load(tmp_path / "m.npz")
    assert math.isnan(again.path[0].residual)
    assert again.residual == found.residual
    assert again.load_warning == ""

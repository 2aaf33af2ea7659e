import json

import numpy as np
import pytest

from abfm import Parameters, Problem, TriangleMesh, function, load
from abfm.experiments import Example, match_of_flow
from abfm.experiments.fields import tangential_part
from abfm.flow.flow import Flow
from abfm.maps.quality import quality_table
from tests.messages import check_message, line_with
from tests.shapes import ellipsoid, icosphere


def saved(path, mesh, velocity, target="coordinate:x", tau=1.0):
    f, g = function(mesh, "coordinate:x"), function(mesh, target)
    problem = Problem(mesh, f, g, Parameters(tau=tau, refine=0))
    match_of_flow(Example(problem, "", (), Flow(mesh, velocity, tau))).save(path)
    return path


@pytest.fixture(scope="module")
def rotation(tmp_path_factory):
    """Return a result whose flow turns an ellipsoid by 180 degrees about its axis of symmetry."""
    mesh = ellipsoid(3, 1.0, 1.0, 1.5)
    velocity = np.pi * np.cross([0.0, 0.0, 1.0], mesh.vertices[mesh.faces].mean(axis=1))
    return saved(tmp_path_factory.mktemp("map") / "rotation.npz", mesh, velocity, "expression:-x")


def test_map_of_a_rotation_has_no_folds_and_small_errors(rotation, tmp_path, abfm):
    for name in ("map.txt", "map.npy"):
        output = abfm(f"map {{r}} --out {{t}}/{name}", r=rotation)
        heads, areas = output.out.splitlines()[:2]
        assert heads.split()[-5:] == ["mean", "median", "95%", "98%", "largest"]
        assert areas.startswith("areas, |log2 J|")
        folded = line_with(output.out, "1,280")
        check_message(folded, 0)
        assert output.out.endswith(f"\nwrote {tmp_path / name}\n")
        assert output.err == ""
    assert folded in abfm("map {r}", r=rotation).out  # without an output file
    mesh, found = load(rotation).mesh, np.load(tmp_path / "map.npy")
    places = mesh.vertices * [-1, -1, 1]
    assert np.abs(mesh.vertices[found] - places).max() < 0.1
    values = function(mesh, f"permuted:{tmp_path / 'map.txt'}(coordinate:x)")
    np.testing.assert_array_equal(values, mesh.vertices[found, 0])
    half_turn = [np.argmin(np.linalg.norm(mesh.vertices - p, axis=1)) for p in places]
    np.savetxt(tmp_path / "truth.txt", half_turn, fmt="%d")
    right = json.loads(abfm("map {r} --truth {t}/truth.txt --json", r=rotation).out)["accuracy"]
    assert right["mean"] < 0.03
    assert right["vertices"] == len(mesh.vertices)
    output = abfm("map {r} --truth identity", r=rotation).out
    assert len(line_with(output, "error, sqrt(area)").split()) == 7
    still = json.loads(abfm("map {r} --truth identity --time 0 --json", r=rotation).out)
    assert still["accuracy"]["maximum"] < 1e-6


@pytest.fixture(scope="module")
def folding(tmp_path_factory):
    """Return a result of a field without smoothness, whose flow folds many faces."""
    mesh = icosphere(2)
    velocity = 10 * tangential_part(
        mesh, np.random.default_rng(0).normal(size=(len(mesh.faces), 3))
    )
    return saved(tmp_path_factory.mktemp("map") / "folding.npz", mesh, velocity, tau=0.5)


def test_folding_flow_has_a_warning(folding, tmp_path, abfm):
    match = load(folding)
    np.save(tmp_path / "uv.npy", match.mesh.vertices)
    found = match.flow.map_quality()
    assert found.warning
    for words in ("", "--functional-map=5", "--push={t}/uv.npy"):
        output = abfm(f"map {{r}} --out {{t}}/out.npy {words}", r=folding)
        assert output.err == f"warning: {found.warning}\n"
        table = quality_table(found.distortion, found.round_trip)
        assert output.out.splitlines() == [*table, f"wrote {tmp_path / 'out.npy'}"]


def test_json_has_the_facts_of_a_map(folding, rotation, tmp_path, abfm):
    for path, time in ((folding, -0.5), (folding, 0.0), (rotation, 1.0)):
        output = abfm(f"map {{r}} --time {time} --json", r=path)
        quality = json.loads(output.out)["quality"]
        found = load(path).flow.map_quality(time)
        for name in ("log2_area", "log2_shape"):
            assert quality[name] == getattr(found.distortion, name)._asdict()
        assert quality["round_trip"] == found.round_trip._asdict()
        assert (quality["folded"], quality["warning"]) == (found.distortion.folded, found.warning)
        assert output.err == (f"warning: {found.warning}\n" if found.warning else "")


def test_inverse_is_the_map_of_negative_time(rotation, tmp_path, abfm):
    abfm("map {r} --out={t}/inverse.txt --inverse --time=0.3", r=rotation)
    abfm("map {r} --out {t}/below.txt --time -0.3", r=rotation)
    assert (tmp_path / "inverse.txt").read_text() == (tmp_path / "below.txt").read_text()


def test_values_return_to_their_vertices(rotation, tmp_path, abfm):
    mesh = load(rotation).mesh
    np.save(tmp_path / "uv.npy", mesh.vertices[:, :2])
    abfm("map {r} --push {t}/uv.npy --out {t}/there.npy", r=rotation)
    assert np.abs(np.load(tmp_path / "there.npy") + mesh.vertices[:, :2]).max() < 0.05
    abfm("map {r} --push {t}/there.npy --time -1 --out {t}/back.csv", r=rotation)
    back = np.loadtxt(tmp_path / "back.csv", delimiter=",")
    np.testing.assert_allclose(back, mesh.vertices[:, :2], atol=0.02)
    sphere = icosphere(2)
    mesh = TriangleMesh(np.concatenate([[[9.0, 9, 9]], sphere.vertices]), sphere.faces + 1)
    still = saved(tmp_path / "still.npz", mesh, np.zeros((len(mesh.faces), 3)))
    abfm("map {r} --out {t}/map.txt", r=still)
    assert np.loadtxt(tmp_path / "map.txt").tolist() == [-1, *range(1, len(sphere.vertices) + 1)]
    table = np.arange(2.0 * mesh.file_vertex_count).reshape(-1, 2)
    np.save(tmp_path / "uv.npy", table)
    abfm("map {r} --push {t}/uv.npy --out {t}/out.npy", r=still)
    table[0] = np.nan
    np.testing.assert_allclose(np.load(tmp_path / "out.npy"), table, atol=1e-9)


def test_functional_map_is_nearly_orthogonal(rotation, tmp_path, abfm):
    abfm("map {r} --functional-map 12 --out {t}/C.npy", r=rotation)
    C = np.load(tmp_path / "C.npy")
    np.testing.assert_allclose(C[:, 0], np.eye(12)[0], atol=1e-6)
    np.testing.assert_allclose(C.T @ C, np.eye(12), atol=0.05)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("--push uv.npy", ["--out"]),
        ("--functional-map 5", ["--out"]),
        ("--out map.obj", [".txt", ".csv", ".npy"]),
        ("--out map.txt --push none.npy", ["none.npy"]),
        ("--out short.npy --push short.npy", ["short.npy"]),
        ("--out map.txt --push short.npy", ["short.npy", 3]),
        ("--out map.txt --push inf.npy", ["inf.npy"]),
        ("--out C.npy --functional-map 0", [0]),
        ("--out C.npy --functional-map 100000", [100000]),
        ("--truth none.txt", ["none.txt"]),
        ("--out map.txt --time nan", ["time"]),
        ("--out map.txt --time 1e9", ["time"]),
    ],
)
def test_bad_input_is_refused(rotation, words, named, abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("short.npy", np.zeros(3))
    np.save("inf.npy", np.full(len(load(rotation).mesh.vertices), np.inf))
    check_message(abfm(f"map {{r}} {words}", r=rotation, status=2).err, *named)


def test_values_that_contradict_the_field_are_recomputed(rotation, tmp_path, abfm):
    with np.load(rotation) as file:
        arrays = dict(file)
    cheat = arrays | {"velocity": np.zeros_like(arrays["velocity"])}
    np.savez(path := tmp_path / "cheat.npz", **cheat)
    for line in ("map {t}/cheat.npz --truth=identity", "render {t}/cheat.npz --out={t}/a.png"):
        [warning] = abfm(line).err.splitlines()
        assert warning.startswith("warning: ")
        check_message(warning, path, 2)

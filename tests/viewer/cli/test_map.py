"""`abfm map`, run in this process."""

import json

import numpy as np
import pytest

from abfm import Parameters, Problem, TriangleMesh, function, load
from abfm.calculus.eigenbasis import eigenbasis
from abfm.experiments import Example, as_match
from abfm.experiments.fields import tangent
from abfm.flow.flow import Flow
from tests.messages import check_message, line_with
from tests.shapes import ellipsoid, icosphere


def saved(path, mesh, velocity, target="coordinate:x", tau=1.0):
    """A result file of a flow that nobody searched."""
    f, g = function(mesh, "coordinate:x"), function(mesh, target)
    problem = Problem(mesh, f, g, Parameters(tau=tau, refine=0))
    as_match(Example(problem, "", (), Flow(mesh, velocity, tau))).save(path)
    return path


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """The result of half a turn of an ellipsoid of revolution about its axis, z."""
    mesh = ellipsoid(3, 1.0, 1.0, 1.5)
    velocity = np.pi * np.cross([0.0, 0.0, 1.0], mesh.vertices[mesh.faces].mean(axis=1))
    return saved(tmp_path_factory.mktemp("map") / "turned.npz", mesh, velocity, "expression:-x")


def test_the_map_is_half_a_turn_works_in_functions_and_its_errors_are_told(turned, tmp_path, abfm):
    for name in ("map.txt", "map.npy", "map.csv"):
        said = abfm("map", turned, "--out", tmp_path / name)
        areas, folded = said.out.splitlines()[0], line_with(said.out, "1280")
        check_message(areas, "|log2 J|")
        check_message(folded, 0)
        assert said.out.endswith(f"\nwrote {tmp_path / name}\n")
        assert said.err == ""
    assert folded in abfm("map", turned).out  # which needs no file
    mesh, found = load(turned).mesh, np.load(tmp_path / "map.npy")
    places = mesh.vertices * [-1, -1, 1]
    assert np.abs(mesh.vertices[found] - places).max() < 0.1
    values = function(mesh, f"permuted:{tmp_path / 'map.txt'}(coordinate:x)")
    np.testing.assert_array_equal(values, mesh.vertices[found, 0])
    half_turn = [np.argmin(np.linalg.norm(mesh.vertices - p, axis=1)) for p in places]
    np.savetxt(tmp_path / "truth.txt", half_turn, fmt="%d")
    told = abfm("map", turned, "--truth", tmp_path / "truth.txt", "--json").out
    right = json.loads(told)["accuracy"]
    assert right["mean"] < 0.03
    assert right["vertices"] == len(mesh.vertices)
    check_message(line_with(abfm("map", turned, "--truth", "identity").out, "error"))
    told = abfm("map", turned, "--truth", "identity", "--time", "0", "--json").out
    assert json.loads(told)["accuracy"]["maximum"] < 1e-6


@pytest.fixture(scope="module")
def wild(tmp_path_factory):
    """The result of a field without any smoothness, whose flow gathers points."""
    mesh = icosphere(2)
    velocity = 10 * tangent(mesh, np.random.default_rng(0).normal(size=(len(mesh.faces), 3)))
    return saved(tmp_path_factory.mktemp("map") / "wild.npz", mesh, velocity, tau=0.5)


@pytest.mark.parametrize("what", [[], ["--inverse"], ["--functional-map=5"], ["--carry={}/uv.npy"]])
def test_what_is_no_map_is_told_and_warned_of_in_one_line(wild, what, tmp_path, abfm):
    match = load(wild)
    np.save(tmp_path / "uv.npy", match.mesh.vertices)
    words = [word.format(tmp_path) for word in what]
    said = abfm("map", wild, "--out", tmp_path / "out.npy", *words)
    found = match.flow.map_quality()
    assert "come back" in found.warning
    assert said.err == f"warning: {found.warning}\n"
    assert said.out == f"{found.report()}\nwrote {tmp_path / 'out.npy'}\n"


def test_json_has_the_numbers_of_the_map_that_is_asked_for(wild, turned, tmp_path, abfm):
    for path, time in ((wild, 0.5), (wild, -0.5), (wild, 0.0), (turned, 1.0)):
        said = abfm("map", path, "--time", time, "--out", tmp_path / "map.txt", "--json")
        told = json.loads(said.out)["quality"]
        found = load(path).flow.map_quality(time)
        for name in ("log2_area", "log2_shape"):
            assert told[name] == getattr(found.distortion, name)._asdict()
        assert told["there_and_back"] == found.there_and_back._asdict()
        assert (told["folded"], told["warning"]) == (found.distortion.folded, found.warning)
        assert said.err == (f"warning: {found.warning}\n" if found.warning else "")
        assert (found.warning is None) == (path is turned or time == 0)


def test_the_inverse_is_the_map_of_the_time_below_zero(turned, tmp_path, abfm):
    abfm("map", turned, f"--out={tmp_path}/inverse.txt", "--inverse", "--time=0.3")
    abfm("map", turned, "--out", tmp_path / "below.txt", "--time", "-0.3")
    assert (tmp_path / "inverse.txt").read_text() == (tmp_path / "below.txt").read_text()


def test_transferred_values_come_back_without_unused_vertices(turned, tmp_path, abfm):
    mesh = load(turned).mesh
    np.save(tmp_path / "uv.npy", mesh.vertices[:, :2])
    there, back = tmp_path / "there.npy", tmp_path / "back.csv"
    abfm("map", turned, "--carry", tmp_path / "uv.npy", "--out", there)
    assert np.abs(np.load(there) + mesh.vertices[:, :2]).max() < 0.05
    abfm("map", turned, "--carry", there, "--time", "-1", "--out", back)
    np.testing.assert_allclose(np.loadtxt(back, delimiter=","), mesh.vertices[:, :2], atol=0.02)
    sphere = icosphere(2)
    mesh = TriangleMesh(np.concatenate([[[9.0, 9, 9]], sphere.vertices]), sphere.faces + 1)
    still = saved(tmp_path / "still.npz", mesh, np.zeros((len(mesh.faces), 3)))
    abfm("map", still, "--out", tmp_path / "map.txt")
    assert np.loadtxt(tmp_path / "map.txt").tolist() == [-1, *range(1, len(sphere.vertices) + 1)]
    table = np.arange(2.0 * mesh.file_vertex_count).reshape(-1, 2)
    np.save(tmp_path / "uv.npy", table)
    abfm("map", still, "--carry", tmp_path / "uv.npy", "--out", tmp_path / "out.npy")
    table[0] = np.nan
    np.testing.assert_allclose(np.load(tmp_path / "out.npy"), table, atol=1e-9)


def test_the_functional_map_is_nearly_orthogonal_and_keeps_the_constant(turned, tmp_path, abfm):
    abfm("map", turned, "--functional-map", "12", "--out", tmp_path / "C.npy")
    C = np.load(tmp_path / "C.npy")
    np.testing.assert_allclose(C[:, 0], np.eye(12)[0], atol=1e-6)
    np.testing.assert_allclose(C.T @ C, np.eye(12), atol=0.05)
    match = load(turned)
    assert eigenbasis(match.mesh.normalized(), 12)[1].shape == (len(match.mesh.vertices), 12)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--carry", "uv.npy"], ("--out",)),
        (["--functional-map", "5"], ("--out",)),
        (["--out", "map.obj"], (".txt", ".csv", ".npy")),
        (["--out", "map.txt", "--carry", "none.npy"], ("none.npy",)),
        (
            ["--out", "short.npy", "--carry", "short.npy"],
            ("short.npy",),
        ),
        (["--out", "map.txt", "--carry", "short.npy"], ("short.npy", 3)),
        (["--out", "map.txt", "--carry", "inf.npy"], ("inf.npy",)),
        (["--out", "C.npy", "--functional-map", "0"], (0,)),
        (["--out", "C.npy", "--functional-map", "100000"], (100000,)),
        (["--truth", "none.txt"], ("none.txt",)),
        (["--out", "map.txt", "--time", "nan"], ("time",)),
        (["--out", "map.txt", "--time", "1e9"], ("time",)),
    ],
)
def test_bad_words_are_refused_in_one_line(turned, words, named, abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("short.npy", np.zeros(3))
    np.save("inf.npy", np.full(len(load(turned).mesh.vertices), np.inf))
    check_message(abfm("map", turned, *words, status=2).err, *named)


def test_a_file_whose_field_was_taken_out_is_not_believed(turned, tmp_path, abfm):
    with np.load(turned) as file:
        arrays = dict(file)
    np.savez(
        path := tmp_path / "cheat.npz", **arrays | {"velocity": np.zeros_like(arrays["velocity"])}
    )
    for command in (["map", path, "--truth=identity"], ["render", path, f"--out={tmp_path}/a.png"]):
        [line] = abfm(*command).err.splitlines()
        assert line.startswith("warning: ")
        check_message(line, path, 2)

"""`abfm sequence`, and what `abfm info` and `abfm render` say of its files, run in this process."""

import argparse
import errno
import json
import os
import signal
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

import abfm as library
from abfm import load
from abfm.io import export_ply
from abfm.reading import read_collection, read_stc
from abfm.sequences import defaults, vertex_speed
from abfm.sequences.task import SequenceTask
from abfm.sequences.verdicts import verdict_of
from abfm_viewer.cli import options
from tests.core.sequences.turning_film import MESH, TIMES, film
from tests.messages import check_message, check_names, line_with
from tests.viewer.cli.test_signals import ended, start

STEP = TIMES[1] - TIMES[0]
SOLVED = ["--sigma", "0.1", "--quiet"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A sphere, and a function that turns with it."""
    folder = tmp_path_factory.mktemp("film")
    export_ply(folder / "m.ply", MESH, {}, {})
    np.save(folder / "f.npy", film())
    np.savez(folder / "f.npz", frames=film(), times=TIMES)
    return folder


def test_a_film_is_solved_told_and_written_in_several_forms(files, tmp_path, abfm):
    outs = [tmp_path / name for name in ("s.npz", "s.pvd", "s-lh.stc", "lh.s.func.gii", "s.html")]
    words = [f"--out={out}" for out in outs]
    tables = ["--tracks", tmp_path / "t.csv", "--intervals", tmp_path / "i.csv"]
    told = abfm("sequence", files / "m.ply", files / "f.npz", "--sigma=0.1", *words, *tables)
    found, wanted = load(outs[0]), library.sequence(MESH, film(), TIMES, given(sigma=0.1))
    np.testing.assert_array_equal(found.velocity, wanted.velocity)
    lines = told.out.splitlines()
    check_message(lines[0], 4, "matched")
    check_message(lines[1].partition(";")[0], 5, "-0.1", "0.1", 320)
    speed = np.linalg.norm(wanted.velocity, axis=2)
    everywhere = f"{np.median(speed):.3g} everywhere, at most {speed.max():.3g}, in the mesh"
    assert everywhere in lines[2]
    check_message(lines[2], "per second")
    check_message(lines[3], 3, "2 spirals")
    check_message(line_with(told.out, "uncertainty: "), f"{np.median(found.speed_uncertainty):.3g}")
    check_message(line_with(told.out, "frames in between: "), "100%")
    assert "wrote " in lines[-1]
    assert "following the frames: 50%" in told.err.splitlines()
    assert len(read_collection(outs[1])) == 5
    np.testing.assert_array_equal(
        read_stc(outs[2].read_bytes()).values.T, vertex_speed(found).astype(np.float32)
    )
    assert len((tmp_path / "i.csv").read_text().splitlines()) == 5
    assert len((tmp_path / "t.csv").read_text().splitlines()) >= 9
    assert "4 of 4 intervals" in outs[4].read_text(encoding="utf-8")
    again = tmp_path / "again" / "s.html"
    again.parent.mkdir()
    abfm("render", outs[0], "--out", again)
    assert again.read_bytes() == outs[4].read_bytes()
    assert abfm("info", outs[0]).out.splitlines()[1:4] == lines[1:4]


def given(**changes):
    return defaults(**changes)


def test_seconds_between_frames_may_be_said(files, tmp_path, abfm):
    told = abfm(
        "sequence",
        files / "m.ply",
        files / "f.npy",
        f"--dt={STEP}",
        *SOLVED,
        f"--out={tmp_path}/a.npz",
    )
    assert told.err == ""
    np.testing.assert_allclose(load(tmp_path / "a.npz").times, TIMES - TIMES[0])
    told = abfm(
        "sequence", files / "m.ply", files / "f.npz", "--dt=1", *SOLVED, f"--out={tmp_path}/a.npz"
    )
    np.testing.assert_array_equal(load(tmp_path / "a.npz").times, np.arange(5))
    assert "per second" in told.out
    told = abfm("sequence", files / "m.ply", files / "f.npy", *SOLVED, f"--out={tmp_path}/a.npz")
    check_message(line_with(told.err, "note: "), 1, "--dt")
    assert "per frame" in told.out
    assert "unit per frame\n" in abfm("info", tmp_path / "a.npz").out


def test_machines_are_told_and_parameters_are_taken(files, tmp_path, abfm):
    told = abfm(
        "sequence",
        files / "m.ply",
        files / "f.npz",
        "--gamma=0",
        "--alpha=0.5",
        "--set=order=2",
        "--sigma=0.2",
        "--json",
        "--mask=expression:x>-2",
        "--quiet",
        f"--out={tmp_path}/a.npz",
    ).out
    facts = json.loads(told)
    found = load(tmp_path / "a.npz")
    assert (facts["intervals"], facts["confirmed"]) == (4, found.confirmed)
    assert (facts["gamma"], facts["sigma"], facts["parameters"]["alpha"]) == (0, 0.2, 0.5)
    assert facts["parameters"]["order"] == 2
    assert facts["motion_share"] == pytest.approx(found.motion_share)
    assert facts["uncertainty"] == pytest.approx(found.speed_uncertainty)
    assert facts["determined"] == pytest.approx(found.speed_determined)
    assert facts["verdicts"] == [each.kind for each in found.verdicts]
    for name in ("residual", "verified_residual"):
        np.testing.assert_array_equal(facts[name], getattr(found, name))
    assert facts["speed"]["maximum"] == np.linalg.norm(found.velocity, axis=2).max()
    # the pattern turns; where it is flat the field is what is smooth
    assert facts["speed"]["median_where_steep"] != facts["speed"]["median"] > 0
    assert facts["tracks"]["spiral"] == len([t for t in found.tracks() if t.kind == "spiral"])
    assert facts["frames_file"].endswith("f.npz")
    again = json.loads(abfm("info", tmp_path / "a.npz", "--json").out)
    assert {name: again[name] for name in again if name in facts} == {
        name: facts[name] for name in again if name in facts
    }
    assert abfm("info", tmp_path / "a.npz").out.splitlines()[0].endswith("lines: 4 matched")


def test_channels_are_weighed(files, tmp_path, abfm):
    np.save(tmp_path / "two.npy", np.stack([film(), film()[::-1]], axis=2))
    words = [
        "sequence",
        files / "m.ply",
        tmp_path / "two.npy",
        "--dt=1",
        *SOLVED,
        f"--out={tmp_path}/a.npz",
    ]
    abfm(*words, "--weights", "0,1")
    backward = load(tmp_path / "a.npz")
    abfm(*words, "--weights", "1,0")
    forward = load(tmp_path / "a.npz")
    np.testing.assert_array_equal(forward[0].weights, [1, 0])
    assert (forward.velocity * backward.velocity).sum() < 0


def test_fewer_than_half_confirmed_is_an_exit_status_of_its_own(files, tmp_path, abfm):
    noise = np.random.default_rng(0).normal(size=film().shape)
    noise[:, ::2] *= 40  # which no flow carries
    np.save(tmp_path / "noise.npy", noise)
    words = [
        "sequence",
        files / "m.ply",
        tmp_path / "noise.npy",
        "--sigma=3",
        "--quiet",
        f"--out={tmp_path}/a.npz",
    ]
    told = abfm(*words, status=3).out
    found = load(tmp_path / "a.npz")
    assert 2 * found.confirmed < len(found)
    check_names(told.splitlines()[0], found.confirmed, 4)


def test_a_page_and_a_sheet_are_drawn_of_a_file(files, tmp_path, abfm):
    abfm("sequence", files / "m.ply", files / "f.npz", *SOLVED, f"--out={tmp_path}/a.npz")
    draw = ["render", tmp_path / "a.npz", "--out"]
    assert abfm(*draw, tmp_path / "a.html").out == f"wrote {tmp_path}/a.html\n"
    headline = load(tmp_path / "a.npz").facts.headline
    assert headline[1:] in (tmp_path / "a.html").read_text(encoding="utf-8")
    for name, times in (("one", ["--time=0"]), ("other", ["--time=0.1"]), ("both", [])):
        abfm(*draw, f"{tmp_path}/{name}.png", "--size", "900x500", *times)
    one, other, both = (
        np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB"), dtype=int)
        for name in ("one", "other", "both")
    )
    assert one.shape == other.shape == both.shape == (500, 900, 3)
    red, blue = (np.abs(one - [r, 40, b]).sum(axis=2) < 90 for r, b in ((200, 50), (40, 150)))
    assert min(red.sum(), blue.sum()) > 5000  # of the function's colours
    assert (np.abs(one - other).max(axis=2) > 20).sum() > 2000  # it has turned
    for name, words, told in (
        ("a.png", ["--time=3"], "expected a time from -0.1 to 0.1"),
        ("a.png", ["--channel=1"], "there are channels 0 to 0"),
        ("a.png", ["--streaks"], "--streaks is for pictures of matches"),
        ("a.html", ["--time=0"], "--time is for pictures and movies"),
    ):
        assert told in abfm(*draw, f"{tmp_path}/{name}", *words, status=2).err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (
            ["{m}", "{f}", "--out", "{t}/a.vtu"],
            (".npz", ".pvd", ".stc", ".gii", ".html"),
        ),
        (["{m}", "{f}", "--out", "{t}/a.stc"], ("-lh.stc", "-rh.stc")),
        (["{m}", "{f}", "--out", "{t}/no/a.npz"], ()),
        (["{m}", "{f}", "--tracks", "{t}/t.txt", "--out", "{t}/a.npz"], (".csv",)),
        (
            ["{m}", "{f}", "--tracks={t}/t.csv", "--intervals={t}/t.csv", "--out={t}/a.npz"],
            (),
        ),
        (["{m}", "{f}", "--dt", "0", "--out", "{t}/a.npz"], ("--dt", 0)),
        (
            ["{m}", "{f}", "--dt=1", "--gamma=-1", "--out={t}/a.npz"],
            ("--gamma", -1, 0),
        ),
        (
            ["{m}", "{f}", "--dt=1", "--weights=0", "--out={t}/a.npz"],
            (),
        ),
        (["{m}", "{f}", "--weights", "", "--out", "{t}/a.npz"], ("weights",)),
        (["{m}", "{f}", "--out", "{t}/file/a.npz"], ()),
        (
            ["{m}", "{f}", "--weights", "1,-1", "--out", "{t}/a.npz"],
            (-1, "weights", "1,0.5"),
        ),
        (["{m}", "{f}", "--dt=1", "--weights=1,1", "--out={t}/a.npz"], ()),
        (["{m}", "{f}", "--alpha", "-1", "--out", "{t}/a.npz"], ("alpha", "-1.0")),
        (["{m}", "{f}", "--tau", "2", "--out", "{t}/a.npz"], ("--tau",)),
        (["{m}", "{f}", "--array", "u", "--out", "{t}/a.npz"], ()),
        (["{m}", "{t}/one.npy", "--dt", "1", "--out", "{t}/a.npz"], ()),
        (["{m}", "{t}/short.npy", "--out", "{t}/a.npz"], (162,)),
        (["{m}", "{t}/none.npy", "--out", "{t}/a.npz"], ()),
        (["{m}", "{t}/back.npz", "--out", "{t}/a.npz"], ("times",)),
        (
            ["{m}", "{t}/uneven.npz", "--out={t}/a.npz", "--out={t}/a-lh.stc"],
            ("times",),
        ),
        (
            ["{m}", "{t}/back.npz", "--out", "{t}/back.npz"],
            ("back.npz",),
        ),
        (["{m}", "{t}/x.pvd", "--array", "u", "--out", "{t}/x.pvd"], ("x.pvd",)),
        (["{m}", "{t}/x/x_1.vtu", "--out", "{t}/x.pvd"], ("x.pvd", "x_1.vtu")),
        (
            ["{m}", "{f}", "--mask={t}/t.csv", "--intervals={t}/t.csv", "--out={t}/a.npz"],
            ("t.csv",),
        ),
        (
            ["{m}", "{f}", "--mask=file:{t}/t.csv", "--tracks={t}/t.csv", "--out={t}/a.npz"],
            ("t.csv",),
        ),
        (["~no-user/m.ply", "{f}", "--out", "{t}/a.npz"], ("m.ply",)),
        (["{m}", "{f}", "--mask", "a+" * 200, "--out", "{t}/a.npz"], ()),
        (["{t}/x/m.ply", "{f}", "--out", "{t}/x.pvd"], ("m.ply",)),  # which no frame is called as
        (["{m}", "{f}", "--out", "{t}/file.pvd"], ()),
        (["{m}", "{f}"], ("--out",)),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(words, named, files, tmp_path, abfm):
    np.save(tmp_path / "one.npy", film()[:1])
    np.save(tmp_path / "short.npy", film()[:, :9])
    np.savez(tmp_path / "uneven.npz", frames=film(), times=TIMES**3)
    np.savez(tmp_path / "back.npz", frames=film(), times=TIMES[::-1])
    (tmp_path / "x").mkdir()
    for name in ("file", "x.pvd", "x/x_1.vtu", "x/m.ply", "t.csv"):
        (tmp_path / name).write_text("theirs")
    places = {"m": files / "m.ply", "f": files / "f.npy", "t": tmp_path}
    line = [word.format(**places) for word in words]
    check_message(abfm("sequence", *line, status=2).err.splitlines()[-1], *named)
    assert not (tmp_path / "a.npz").exists()
    assert (tmp_path / "x.pvd").read_text() == (tmp_path / "t.csv").read_text() == "theirs"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_keeps_what_was_found(number, files, tmp_path):
    times = 0.01 * np.arange(400)
    np.savez(tmp_path / "long.npz", frames=film(times=times), times=times)
    words = [
        "sequence",
        files / "m.ply",
        tmp_path / "long.npz",
        "--sigma=0.1",
        f"--out={tmp_path}/a.npz",
    ]
    process = start(*words)
    while "following the frames: 10%" not in process.stderr.readline():
        assert process.poll() is None
    told, errors = ended(process, number)
    assert "stopping" in errors
    assert "Traceback" not in errors
    assert told.startswith("cancelled: ")
    found = load(tmp_path / "a.npz")
    solved = np.abs(found.velocity).max(axis=(1, 2)) > 0
    assert 40 <= np.count_nonzero(solved) < 399
    kinds = np.array([verdict.kind for verdict in found.verdicts])
    assert set(kinds[~solved]) == {"not reached"}
    [kept] = tmp_path.glob("a.npz-*.unfinished")
    check_names(told, kept, np.count_nonzero(~solved))
    median = np.median(np.linalg.norm(found.velocity[solved], axis=2))
    assert f" {median:.3g} everywhere, " in told


def test_a_film_of_which_nothing_was_solved_has_no_speed(files):
    found = library.sequence(MESH, film(), TIMES, given(sigma=0.1))
    unsolved = verdict_of(found[0].problem, None, None, False)
    found = replace(found, velocity=0 * found.velocity, verdicts=4 * (unsolved,))
    _, first, *others = SequenceTask.report.lines(found)
    check_message(first, 0, 4)
    check_message(next(line for line in others if "speed" in line))
    told = json.loads(json.dumps(SequenceTask.report.details(found)))
    assert told["solved"] == 0
    assert set(told["speed"].values()) == {None}
    assert told["episodes"] == []


def test_a_run_that_is_killed_goes_on(files, tmp_path, abfm):
    times = 0.01 * np.arange(30)
    np.savez(tmp_path / "f.npz", frames=film(times=times), times=times)
    words = ["sequence", files / "m.ply", tmp_path / "f.npz", *SOLVED]
    abfm(*words, "--out", tmp_path / "whole.npz")
    process = start(*words, "--out", tmp_path / "a.npz")
    while not [*tmp_path.glob("a.npz-*.unfinished")]:
        assert process.poll() is None
    process.kill()
    process.communicate()
    assert not (tmp_path / "a.npz").exists()
    told = abfm(*words, "--out", tmp_path / "a.npz").err.splitlines()
    assert told[0].startswith("note: ")
    check_names(told[0], 29)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert not [*tmp_path.glob("*.unfinished")]


def test_output_that_fails_leaves_no_unfinished_file(files, tmp_path, abfm, monkeypatch):
    """The result is safe in the other output, and the message names no temporary folder."""
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    monkeypatch.setattr("abfm.io.exports.unstructuredGridToVTK", full, raising=True)
    words = ["sequence", files / "m.ply", files / "f.npz", *SOLVED, "--out", tmp_path / "a.npz"]
    told = abfm(*words, "--out", tmp_path / "b.pvd", status=2).err.splitlines()[-1]
    check_message(told, "b_0000.vtu", "space")
    assert ".abfm-" not in told
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_help_tells_the_defaults_of_films():
    parser = argparse.ArgumentParser(formatter_class=lambda prog: argparse.HelpFormatter(prog, 99))
    options.add_inputs(parser, SequenceTask.inputs)
    text = " ".join(parser.format_help().split())
    for option, default in (("--divergence", "1.0"), ("--sigma", "auto")):
        assert f"(default: {default})" in text.split(f" {option} ", 2)[-1].split(" --")[0]

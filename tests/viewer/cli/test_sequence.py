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
from abfm.reading import read_collection
from abfm.sequences import defaults
from abfm.sequences.task import SequenceTask
from abfm.sequences.verdicts import verdict_of
from abfm_viewer.cli import main, options, progress
from tests.core.sequences.rotating_sphere import MESH, TIMES, rotating_frames
from tests.messages import check_message, check_names, line_with
from tests.processes import words_of

SOLVED = "--sigma 0.1 --quiet"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a sphere, frames of a rotating function, and their result."""
    folder = tmp_path_factory.mktemp("film")
    export_ply(folder / "m.ply", MESH, {}, {})
    np.save(folder / "f.npy", rotating_frames())
    np.savez(folder / "f.npz", frames=rotating_frames(), times=TIMES)
    line = f"sequence {{f}}/m.ply {{f}}/f.npz {SOLVED} --out={{f}}/s.npz"
    assert main(words_of(line, f=folder)) == 0
    return folder


def test_sequence_is_printed_and_written(files, tmp_path, abfm, monkeypatch):
    monkeypatch.setattr(progress, "SILENT_SECONDS", 0.0)
    outs = [tmp_path / name for name in ("s.npz", "s.pvd", "s.html")]
    tables = "--tracks {t}/t.csv --intervals {t}/i.csv"
    line = f"sequence {{f}}/m.ply {{f}}/f.npz --sigma=0.1 {tables}"
    output = abfm(line, *(f"--out={out}" for out in outs), f=files)
    found, expected = (
        load(outs[0]),
        library.sequence(MESH, rotating_frames(), TIMES, defaults(sigma=0.1)),
    )
    np.testing.assert_array_equal(found.velocity, expected.velocity)
    assert output.out.splitlines()[-1].startswith(f"wrote {outs[0]}")
    check_message(output.out.splitlines()[0], 4, "matched")
    lines = abfm("info {t}/s.npz").out.splitlines()
    check_message(lines[0], 4, "matched")
    check_message(lines[1].partition(";")[0], 5, "-0.1", "0.1", 320)
    speed = np.linalg.norm(expected.velocity, axis=2)
    everywhere = f"{np.median(speed):.3g} everywhere, at most {speed.max():.3g}, in the mesh"
    assert everywhere in lines[2]
    check_message(lines[2], "per second")
    check_message(lines[3], 3, "2 spirals")
    check_message(
        line_with("\n".join(lines), "uncertainty: "), f"{np.median(found.speed_uncertainty):.3g}"
    )
    check_message(line_with("\n".join(lines), "frames in between: "), "100%")
    phases = ["choosing sigma", "following the frames", "tracing flow lines", "smoothing in time"]
    assert [*dict.fromkeys(output.err.splitlines())][:4] == phases
    assert len(read_collection(outs[1])) == 5
    assert len((tmp_path / "i.csv").read_text().splitlines()) == 5
    assert len((tmp_path / "t.csv").read_text().splitlines()) >= 9
    assert found.facts.headline[1:] in outs[2].read_text(encoding="utf-8")
    (tmp_path / "again").mkdir()
    abfm("render {t}/s.npz --out {t}/again/s.html")
    assert (tmp_path / "again" / "s.html").read_bytes() == outs[2].read_bytes()


def test_frames_have_times(files, tmp_path, abfm):
    abfm(f"sequence {{f}}/m.ply {{f}}/f.npz --dt=1 {SOLVED} --out={{t}}/a.npz", f=files)
    assert "per second" in abfm("info {t}/a.npz").out
    np.testing.assert_array_equal(load(tmp_path / "a.npz").times, np.arange(5))
    np.save(tmp_path / "f.npy", np.insert(rotating_frames(), 2, np.nan, axis=0))
    output = abfm(f"sequence {{f}}/m.ply {{t}}/f.npy {SOLVED} --out={{t}}/a.npz", f=files)
    check_message(line_with(output.err, "left out"), 1, 2)
    check_message(line_with(output.err, "no times"), 1, "--dt")
    np.testing.assert_array_equal(load(tmp_path / "a.npz").times, [0, 1, 3, 4, 5])
    assert "unit per frame\n" in abfm("info {t}/a.npz").out


def test_json_has_the_parameters_of_a_sequence(files, tmp_path, abfm):
    line = (
        "sequence {f}/m.ply {f}/f.npz --gamma=0 --alpha=0.5 --set=order=2 --sigma=0.2 --json "
        "--mask=expression:x>-2 --channel 0 2 --quiet --out={t}/a.npz"
    )
    facts, found = json.loads(abfm(line, f=files).out), load(tmp_path / "a.npz")
    assert found[0].weights.tolist() == [2]
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


def test_pictures_of_a_sequence_show_its_times(files, tmp_path, abfm):
    for name in ("0", "0.1"):
        abfm(f"render {{f}}/s.npz --out {{t}}/{name}.png --size 450x250 --time={name}", f=files)
    one, other = (
        np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB"), dtype=int)
        for name in ("0", "0.1")
    )
    assert one.shape == other.shape == (250, 450, 3)
    red, blue = (np.abs(one - [r, 40, b]).sum(axis=2) < 90 for r, b in ((200, 50), (40, 150)))
    assert min(red.sum(), blue.sum()) > 1200  # colours of the function
    assert (np.abs(one - other).max(axis=2) > 20).sum() > 500  # the function has rotated
    for words, named in (
        ("a.png --time=3", ["-0.1", "0.1"]),
        ("a.png --channel=1", ["--channel", 0]),
        ("a.png --streaks", ["--streaks"]),
        ("a.html --time=0", ["--time"]),
    ):
        output = abfm(f"render {{f}}/s.npz --out {{t}}/{words}", f=files, status=2)
        check_message(output.err, *named)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("{m} {f} --out {t}/a.stc", ["-lh.stc", "-rh.stc"]),
        ("{m} {f} --tracks={t}/t.csv --intervals={t}/t.csv --out={t}/a.npz", []),
        ("{m} {f} --dt 0 --out {t}/a.npz", ["--dt", 0]),
        ("{m} {f} --dt=1 --gamma=-1 --out={t}/a.npz", ["--gamma", -1, 0]),
        ("{m} {f} --channel 1 2 --out {t}/a.npz", [1]),
        ("{m} {f} --channel 0 -2 --out {t}/a.npz", ["--channel", -2]),
        ("{m} {f} --channel 0 1 --channel 0 2 --out {t}/a.npz", ["--channel", 0]),
        ("{m} {f} --tau 2 --out {t}/a.npz", ["--tau"]),
        ("{m} {t}/short.npy --out {t}/a.npz", [162]),
        ("{m} {t}/back.npz --out {t}/a.npz", ["times"]),
        ("{m} {t}/uneven.npz --out={t}/a.npz --out={t}/a-lh.stc", ["times"]),
        ("{m} {t}/back.npz --out {t}/back.npz", ["back.npz"]),
        ("{m} {t}/x.pvd --array u --out {t}/x.pvd", ["x.pvd"]),
        ("{m} {t}/x/x_1.vtu --out {t}/x.pvd", ["x.pvd", "x_1.vtu"]),
        ("{m} {f} --mask={t}/t.csv --intervals={t}/t.csv --out={t}/a.npz", ["t.csv"]),
        (f"{{m}} {{f}} --mask {'a+' * 200} --out {{t}}/a.npz", []),
        ("{t}/x/m.ply {f} --out {t}/x.pvd", ["m.ply"]),  # "frame" is not a name of a frame
        ("{m} {f} --out {t}/file.pvd", []),
    ],
)
def test_bad_input_is_refused(line, named, files, tmp_path, abfm):
    np.save(tmp_path / "short.npy", rotating_frames()[:, :9])
    np.savez(tmp_path / "uneven.npz", frames=rotating_frames(), times=TIMES**3)
    np.savez(tmp_path / "back.npz", frames=rotating_frames(), times=TIMES[::-1])
    (tmp_path / "x").mkdir()
    for name in ("file", "x.pvd", "x/x_1.vtu", "x/m.ply", "t.csv"):
        (tmp_path / name).write_text("other")
    output = abfm(f"sequence {line}", m=files / "m.ply", f=files / "f.npy", status=2)
    check_message(output.err.splitlines()[-1], *named)
    assert not (tmp_path / "a.npz").exists()
    assert (tmp_path / "x.pvd").read_text() == (tmp_path / "t.csv").read_text() == "other"


def test_interrupted_sequence_resumes(files, tmp_path, abfm, monkeypatch):
    times = 0.01 * np.arange(20)
    np.savez(tmp_path / "long.npz", frames=rotating_frames(times=times), times=times)
    line = "sequence {f}/m.ply {t}/long.npz --sigma=0.1 --out={t}/a.npz"
    abfm(line.replace("a.npz", "complete.npz"), "--quiet", f=files)
    seen = []

    def interrupted(text):
        seen.append(text.startswith("following the frames: "))
        if seen[-1] and sum(seen) == 10:
            os.kill(os.getpid(), signal.SIGTERM)  # shells may ignore SIGINT in the background

    with monkeypatch.context() as patched:
        patched.setattr(progress, "print_line", interrupted)
        for name in ("SILENT_SECONDS", "LINE_SECONDS"):
            patched.setattr(progress, name, 0.0)
        output = abfm(line, f=files, status=143).out
    assert output.startswith("cancelled: not reached")
    found = load(tmp_path / "a.npz")
    solved = np.abs(found.velocity).max(axis=(1, 2)) > 0
    assert 1 <= np.count_nonzero(solved) < 19
    kinds = np.array([verdict.kind for verdict in found.verdicts])
    assert set(kinds[~solved]) == {"not reached"}
    [checkpoint] = tmp_path.glob("a.npz-*.unfinished")
    check_names(output, checkpoint, np.count_nonzero(~solved))
    note = line_with(abfm(line, "--quiet", f=files).err, "note: ")
    check_names(note, np.count_nonzero(solved), 19)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "complete.npz").read_bytes()
    assert not [*tmp_path.glob("*.unfinished")]


def test_sequence_without_solutions_has_no_speed(files):
    found = load(files / "s.npz")
    unsolved = verdict_of(found[0].problem, None, None, False)
    found = replace(found, velocity=0 * found.velocity, verdicts=4 * (unsolved,))
    _, first, *others = SequenceTask.report.lines(found)
    check_message(first, 0, 4)
    check_message(next(line for line in others if "speed" in line))
    output = json.loads(json.dumps(SequenceTask.report.details(found)))
    assert (output["solved"], output["episodes"]) == (0, [])
    assert set(output["speed"].values()) == {None}


def test_failed_output_leaves_no_checkpoint(files, tmp_path, abfm, monkeypatch):
    """If one output fails, the other has the result, and no temporary folder is named."""
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    monkeypatch.setattr("abfm.io.exports.unstructuredGridToVTK", full, raising=True)
    line = f"sequence {{f}}/m.ply {{f}}/f.npz {SOLVED} --out {{t}}/a.npz --out {{t}}/b.pvd"
    output = abfm(line, f=files, status=2).err.splitlines()[-1]
    check_message(output, "b_0000.vtu", "space")
    assert ".abfm-" not in output
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_help_has_the_defaults_of_sequences():
    parser = options.Parser("abfm sequence", "")
    options.add_inputs(parser, SequenceTask.inputs)
    text = " ".join(parser.format_help().split())
    for option, default in (("--divergence", "1.0"), ("--sigma", "auto")):
        assert f"(default: {default})" in text.split(f" {option} ", 2)[-1].split(" --")[0]

"""The command line, run in this process."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import asdict, fields, replace
from functools import partial

import av
import numpy as np
import pytest
import trimesh
from PIL import Image, ImageSequence

import laboratory
from abfm import Parameters, load_match
from abfm.assets import asset_path
from abfm_viewer.cli import main
from abfm_viewer.cli.options import Parser
from abfm_viewer.cli.solving import Outcome
from abfm_viewer.document import verdict_words
from abfm_viewer.errors import DrawingError
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.pictures.sheets import DEFAULT_WIDTH
from abfm_viewer.session.session_files import document_of_result
from tests.processes import argv
from tests.viewer.sessions import EGG

HUMAN = str(asset_path("human_A.off"))
EIGHT = str(asset_path("eight.off"))
PAIR = ["--source", "gaussian:vertex=10,width=0.2", "--target", "gaussian:vertex=40,width=0.2"]
SHORT = ["--iterations", "6", "--quiet"]
UNREACHED = 3  # the exit status of runs that are too short to arrive


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A result file of two channels."""
    path = tmp_path_factory.mktemp("result") / "m.npz"
    channel = ["--channel", "coordinate:x", "coordinate:y", "0.01"]
    assert main(["match", EIGHT, *PAIR, *channel, *SHORT, "--out", str(path)]) == UNREACHED
    return path


def test_without_words_it_shows_all_commands(capsys):
    assert main([]) == 0
    out = capsys.readouterr().out
    for command in ("match", "demo", "figure", "map", "render", "info", "bench"):
        assert f"\n    {command} " in out


@pytest.mark.parametrize("words", [["--help"], ["match", "--help"], ["--version"]])
def test_help_and_version_end_well(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    assert "abfm" in capsys.readouterr().out


def test_what_argparse_gives_the_parsers_of_commands_reaches_them():
    commands = Parser(prog="abfm", description="").add_subparsers()
    # Python 3.14: color
    assert commands.add_parser("match", description="", epilog="the end").epilog == "the end"


def test_help_of_match_names_every_parameter_and_example(capsys):
    with pytest.raises(SystemExit):
        main(["match", "--help"])
    out = capsys.readouterr().out
    assert "abfm match spot.obj --source" in out
    for entry in fields(Parameters):
        assert f"--{entry.name.replace('_', '-')} " in out
        assert not entry.metadata["symbol"] or f"[{entry.metadata['symbol']}]" in out
    assert (
        "exit status is 0 when source and target are matched or nearly so, 3 when the target was "
        "not reached" in " ".join(out.split())
    )


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["mtach"], "did you mean 'match'?"),
        (["info"], "MESH"),
        (["info", EIGHT, "--jsno"], "did you mean '--json'?"),
        (["info", "missing.off"], "missing.off: there is no such file"),
        (["info", __file__], "the format is not known"),
        (["match", EIGHT, *PAIR], "--out"),
        (["match", EIGHT, "--out", "m.npz"], "give --source and --target"),
        (["match", EIGHT, *PAIR[:2], "--out", "m.npz"], "need each other"),
        (["match", EIGHT, *PAIR, "--out", "m.txt"], "must end in .npz, .ply, .vtu, .csv"),
        (["match", EIGHT, *PAIR, "--out", "none/m.npz"], "there is no folder none"),
        (
            ["match", EIGHT, *PAIR, "--out", "m.npz", "--tau", "-1"],
            "tau is -1.0; expected a number above 0",
        ),
        (["match", EIGHT, *PAIR, "--out", "m.npz", "--tau", "soon"], "--tau"),
        (["match", EIGHT, *PAIR, "--out", "m.npz", "--method", "linear"], "--method"),
        (["match", EIGHT, *PAIR, "--out", "m.npz", "--sgima", "1"], "did you mean '--sigma'?"),
        (
            ["match", EIGHT, *PAIR, *argv("--out m.npz --channel coordinate:x coordinate:y z")],
            "not 'z'",
        ),
        (["match", EIGHT, *PAIR, "--out", "m.npz", "--mask", "file:none.npy"], "none.npy"),
        (["match", EIGHT, *PAIR, "--out", "m.npz", "--start", "none.npz"], "none.npz"),
        (
            ["match", EIGHT, "--source", "gausian:vertex=1", *PAIR[2:], "--out", "m.npz"],
            "did you mean 'gaussian'?",
        ),
        (["match", EIGHT, "--source", "gaussian:vertex=999", *PAIR[2:], "--out", "m.npz"], "315"),
        (["bench", "--seconds", "0"], "above 0"),
        (["bench", "--success", "--problems", "0"], "a whole number from 1 to 1000000"),
        (["bench", "--success", "--part", "3/2"], "not a part such as 1/2"),
        (["bench", "--success", "--only-given"], "needs a --mesh"),
        (["render", "none.npz", "--out", "a.png"], "none.npz"),
        (["render", "none.abfm", "--out", "a.mp4"], "none.abfm"),
        (["render", "none.npz", "--out", "a.jpg"], "must end in .png, .mp4, .gif"),
        (["render", "none.npz", "--out", "a.png", "--size", "10x10"], "from 320x240"),
        (["render", "none.npz", "--out", "a.png", "--size", "large"], "is not a size"),
    ],
)
def test_bad_input_is_one_clear_line_and_status_2(words, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("abfm: ")
    assert captured.err.count("\n") == 1
    assert expected in captured.err
    assert list(tmp_path.iterdir()) == []


def test_several_components_are_refused_with_the_way_out(tmp_path, capsys):
    spheres = [trimesh.creation.icosphere(2, radius=radius) for radius in (1.0, 0.3)]
    spheres[1].apply_translation([3, 0, 0])
    path = tmp_path / "two.off"
    trimesh.util.concatenate(spheres).export(path)
    assert main(["info", str(path)]) == 2
    assert "--largest-component" in capsys.readouterr().err
    assert main(["info", str(path), "--largest-component", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["vertices"] == 162
    assert facts["messages"]


def test_match_reports_and_writes_what_it_found(tmp_path, capsys):
    out = tmp_path / "m.npz"
    words = ["match", EIGHT, *PAIR, *argv("--iterations 20 --beta 0 --out"), str(out), "--json"]
    assert main(words) == UNREACHED
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    match = load_match(out)
    assert report["mesh"] == EIGHT
    assert report["outputs"] == [str(out)]
    assert report["iterations"] == len(match.energy_history) - 1 <= 20
    assert report["mismatch"] == match.mismatch
    assert report["energy"]["total"] == match.energy_history[-1, 0]
    assert report["parameters"] == match.parameters.to_dict()
    assert (report["parameters"]["iterations"], report["parameters"]["beta"]) == (20, 0)
    assert report["stop_reason"] == match.stop_reason
    assert report["verified_mismatch"] == match.verified_mismatch
    assert report["folded"] == match.folded
    assert report["verdict"] == json.loads(json.dumps(asdict(match.verdict)))
    assert [remedy["label"] for remedy in report["verdict"]["remedies"]] == [
        "More time",
        "Continue",
    ]
    assert re.search(
        r"^iteration 0  stage 1(, reach [\d.]+)?  energy [\d.]+  mismatch [\d.]+$",
        captured.err,
        re.M,
    )
    assert match.source.shape == (315, 1)
    assert match.advect(0.5).shape == (315,)


def test_match_says_the_outcome_in_a_few_lines(tmp_path, capsys):
    out = tmp_path / "m.npz"
    assert main(["match", EIGHT, *PAIR, *SHORT, "--out", str(out)]) == UNREACHED
    captured = capsys.readouterr()
    match = load_match(out)
    assert captured.err == ""
    said, why, numbers, *advice = captured.out.splitlines()
    assert said == verdict_words.headline(match)
    assert why == verdict_words.why(match)
    assert numbers.startswith(
        f"mismatch {match.mismatch:.3g}, {match.verified_mismatch:.3g} by flow lines, "
    )
    assert numbers.endswith(f" s; wrote {out}")
    assert advice == [f"to try: {verdict_words.advice_in_options(match, str(out))}"]


def test_match_of_what_cannot_match_says_so_and_what_to_try(tmp_path, capsys):
    out = tmp_path / "m.npz"
    pair = ["--source", "expression:1", "--target", PAIR[3]]
    assert main(["match", EIGHT, *pair, *SHORT, "--out", str(out)]) == UNREACHED
    said = capsys.readouterr().out
    assert said.startswith("impossible\nthe source is constant")
    assert "\nto try: " in said


def test_what_is_advised_on_the_command_line_can_be_typed_there_and_helps(tmp_path, capsys):
    """A source that nothing leads to its target is warned of while it runs, once, and reached
    with the options.
    """
    mesh = str(tmp_path / "egg.off")
    trimesh.Trimesh(EGG.vertices, EGG.faces, process=False).export(mesh)
    far = argv(
        "--source gaussian:x=0,y=0,z=1,width=0.1 --target gaussian:x=0.5,y=0,z=-0.87,width=0.1"
    )
    words = ["match", mesh, *far, *argv("--reach 0 --iterations 40 --quiet --out")]
    words.append(str(tmp_path / "m.npz"))
    assert main(words) == UNREACHED
    captured = capsys.readouterr()
    assert "\nthe flow squeezed the source to nothing" in captured.out
    assert re.fullmatch(
        r"warning: iteration \d+: the source is being squeezed to nothing .*\n", captured.err
    )
    options = re.search(r"^to try: reach further \((.*?)\)$", captured.out, re.M)[1]
    before = load_match(tmp_path / "m.npz").mismatch
    assert main([*words, *options.split()]) == 0
    assert load_match(tmp_path / "m.npz").mismatch < 0.2 * before


def test_progress_tells_meshes_stages_and_reach(tmp_path, capsys):
    words = ["--iterations", "40", "--levels", "2", "--reach", "0.4"]
    assert main(["match", HUMAN, *PAIR, *words, "--out", str(tmp_path / "m.npz")]) == 0
    said = capsys.readouterr().err
    # thin triangles: the mesh itself comes twice
    assert "iteration 0  mesh 1/3, stage 1, reach 0.4  energy" in said
    assert "  mesh 2/3, stage " in said


def test_what_is_not_known_is_null_for_machines(result):
    match = replace(load_match(result), verified_mismatch=float("nan"), folded=float("nan"))
    described = Outcome(match, 1.0, [], False).to_dict()
    assert described["verified_mismatch"] is described["folded"] is None
    assert "flow lines" not in Outcome(match, 1.0, [], False).summary().splitlines()[0]


def test_channels_and_their_weights_reach_the_solver(result):
    match = load_match(result)
    assert match.source.shape == (315, 2)
    assert match.weights == pytest.approx([1, 0.01])
    assert match.target[:, 1] == pytest.approx(match.mesh.vertices[:, 1])


@pytest.mark.parametrize("as_file", [False, True])
def test_a_mask_is_a_function_or_its_file(as_file, tmp_path):
    out, values = tmp_path / "m.npz", tmp_path / "a mask, 1.npy"
    np.save(values, np.linspace(0, 1, 315))
    mask = str(values) if as_file else "expression:1+x*x"
    assert main(["match", EIGHT, *PAIR, *SHORT, "--mask", mask, "--out", str(out)]) == UNREACHED
    match = load_match(out)
    expected = np.linspace(0, 1, 315) if as_file else 1 + match.mesh.vertices[:, 0] ** 2
    assert match.mask == pytest.approx(expected)


def test_a_warm_start_begins_where_the_earlier_result_ended(tmp_path):
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    one_stage = ["--cooling-stages", "1", "--reach", "0", "--levels", "1", "--balance", "0"]
    words = ["match", EIGHT, *PAIR, *one_stage, "--quiet", "--iterations"]
    assert main([*words, "8", "--out", str(first)]) == UNREACHED
    assert main([*words, "1", "--start", str(first), "--out", str(second)]) == UNREACHED
    assert load_match(second).energy_history[0] == pytest.approx(
        load_match(first).energy_history[-1]
    )


def test_a_warm_start_from_another_mesh_is_refused(result, tmp_path, capsys):
    words = ["--start", str(result), "--out", str(tmp_path / "m.npz")]
    assert main(["match", HUMAN, *PAIR, *words]) == 2
    assert "another mesh" in capsys.readouterr().err


def test_exports_hold_the_functions_and_the_field(tmp_path):
    paths = [tmp_path / name for name in ("m.npz", "m.ply", "m.vtu", "m.csv")]
    words = ["--method", "linearised", "--segments", "2", *SHORT]
    assert main(["match", EIGHT, *PAIR, *words, *(f"--out={path}" for path in paths)]) == UNREACHED
    npz, ply, vtu, csv = paths
    match = load_match(npz)
    attributes = trimesh.load(ply, process=False).metadata["_ply_raw"]
    assert attributes["vertex"]["data"]["advected"].ravel() == pytest.approx(match.advected[:, 0])
    assert attributes["face"]["data"]["velocity_segment_1_2"].ravel() == pytest.approx(
        match.velocity[1, :, 2]
    )
    text = vtu.read_bytes()
    for name in ("source", "target", "advected", "velocity_segment_0", "velocity_segment_1"):
        assert f'Name="{name}"'.encode() in text
    assert csv.read_text().splitlines()[0] == "iteration,stage,total,regularity,mismatch"
    assert len(csv.read_text().splitlines()) == len(match.energy_history) + 1


def test_info_tells_the_facts_of_a_mesh(capsys):
    assert main(["info", EIGHT]) == 0
    text = capsys.readouterr().out
    for word in ("315", "634", "951", "genus         2", "none (closed)", "no objection"):
        assert word in text
    assert main(["info", EIGHT, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["vertices"], facts["faces"], facts["edges"], facts["genus"]) == (315, 634, 951, 2)
    assert facts["usable"] is True
    assert facts["boundary_loops"] == 0
    lengths = facts["edge_lengths"]
    assert facts["edge_ratio"] == pytest.approx(lengths["longest"] / lengths["shortest"])
    assert facts["length_scale"] ** 2 == pytest.approx(facts["area"])


def test_info_tells_the_symmetries_that_functions_can_be_composed_with(capsys):
    assert main(["info", HUMAN]) == 0
    text = capsys.readouterr().out
    assert "mirror        with normal 1 0 0, vertices to vertices" in text
    assert "rotation      none found" in text
    assert main(["info", HUMAN, "--json"]) == 0
    symmetries = json.loads(capsys.readouterr().out)["symmetries"]
    assert symmetries["rotation"] is None
    assert symmetries["mirror"]["is_permutation"] is True
    assert symmetries["mirror"]["error"] < 1e-9
    assert symmetries["mirror"]["axis"] == pytest.approx([1, 0, 0])


def test_names_that_cannot_be_printed_stay_on_their_lines(tmp_path, capsys):
    folder = tmp_path / "a\nb\x1b[31m"
    folder.mkdir()
    mesh, result, table, picture = (
        str(folder / f"c\n.{suffix}") for suffix in ("off", "npz", "txt", "png")
    )
    shutil.copy(EIGHT, mesh)
    for words, status, told in (
        (["info", mesh], 0, "/a?b?[31m/c?.off"),
        (["match", mesh, *PAIR, *SHORT, "--out", result], UNREACHED, "--start {}/a?b?[31m/c?.npz"),
        (["map", result, "--out", table], 0, "wrote {}/a?b?[31m/c?.txt"),
        (
            ["render", result, "--out", picture, "--size", "320x240"],
            0,
            "wrote {}/a?b?[31m/c?.png (320 x 240)",
        ),
    ):
        assert main(words) == status
        lines = capsys.readouterr().out.splitlines()
        assert all(line.isprintable() for line in lines)
        assert told.format(tmp_path) in "".join(lines)


def test_info_of_a_refused_mesh_says_so_to_machines_too(tmp_path, capsys):
    path = tmp_path / "fan.off"
    path.write_text("OFF\n5 3 0\n0 0 0\n0 0 1\n1 0 0\n-1 1 0\n-1 -1 0\n3 0 1 2\n3 0 1 3\n3 0 1 4\n")
    assert main(["info", str(path), "--json"]) == 2
    captured = capsys.readouterr()
    told = json.loads(captured.out)
    assert told["usable"] is False
    assert captured.err == f"abfm: {told['objection']}\n"


def test_render_draws_the_channel_and_size_asked_for(result, tmp_path, capsys):
    picture = tmp_path / "a.png"
    words = ["render", str(result), "--out", str(picture)]
    words += argv("--size 800x400 --time 0.5 --channel 1")
    assert main([*words, "--up", "z"]) == 0
    with Image.open(picture) as image:
        assert image.size == (800, 400)
    assert str(picture) in capsys.readouterr().out
    assert main([*words[:-1], "2"]) == 2
    assert "channels 0 to 1" in capsys.readouterr().err


@pytest.fixture(scope="module")
def project(result, tmp_path_factory):
    """The result as a project."""
    path = tmp_path_factory.mktemp("project") / "m.abfm"
    save_project(path, *document_of_result(load_match(result), result))
    return path


def test_render_draws_a_project_as_its_window_shows_it(project, tmp_path, capsys):
    picture = tmp_path / "a.png"
    whole = argv("--size 400x300 --transparent")
    assert main(["render", str(project), "--out", str(picture), *whole]) == 0
    assert capsys.readouterr().out == f"wrote {picture} (400 x 300)\n"
    with Image.open(picture) as shown:
        assert (shown.size, shown.mode) == ((400, 300), "RGBA")
        assert shown.getextrema()[3] == (0, 255)
    bare = argv("--size 400x300 --no-color-bar --no-labels --channel 1 --up z --time 0")
    assert main(["render", str(project), "--out", str(picture), *bare]) == 0
    with Image.open(picture) as shown:
        assert (shown.size, shown.mode) == ((400, 300), "RGB")


def test_render_makes_sheets_of_projects_and_window_pictures_of_results(result, project, tmp_path):
    sheets, windows = [], []
    for number, path in enumerate((result, project)):
        for style, found in (("sheet", sheets), ("window", windows)):
            picture = tmp_path / f"{style}{number}.png"
            words = argv(f"--style {style} --size 640x400 --out")
            assert main(["render", str(path), *words, str(picture)]) == 0
            found.append(np.asarray(Image.open(picture)))
    for first, second in (sheets, windows):
        assert (first == second).all()


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_render_writes_movies(suffix, result, project, tmp_path, capsys):
    for path in (result, project):
        movie = tmp_path / f"{path.stem}{suffix}"
        words = argv("--size 330x240 --seconds 0.5 --fps 8 --to 2 --turntable -90")
        assert main(["render", str(path), "--out", str(movie), *words]) == 0
        captured = capsys.readouterr()
        assert captured.out == f"wrote {movie} (330 x 240, 4 frames)\n"
        assert captured.err == "".join(f"frame {frame} of 4\n" for frame in (1, 2, 3, 4))
        with av.open(str(movie)) as file:
            frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert (len(frames), frames[0].shape) == (4, (240, 330, 3))
        assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


@pytest.mark.usefixtures("coarse_streaks")
def test_render_draws_streaks_that_move_in_a_loop(result, tmp_path):
    """The frames of a GIF at one time differ by the streaks alone, from the last to the first as
    elsewhere.
    """
    gif = tmp_path / "a.gif"
    words = argv("--streaks --from 1 --to 1 --seconds 0.4 --fps 10 --size 320x240")
    assert main(["render", str(result), "--out", str(gif), *words]) == 0
    with Image.open(gif) as movie:
        assert (movie.n_frames, movie.info["loop"]) == (4, 0)
        frames = [
            np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(movie)
        ]
    steps = [np.abs(frames[i] - frames[i - 1]).mean() for i in range(4)]
    assert 0.1 < max(steps) < 1.5 * min(steps)


@pytest.mark.usefixtures("coarse_streaks")
def test_render_draws_streaks_that_fade(result, tmp_path):
    pictures = []
    for number, words in enumerate(([], ["--streaks"], ["--streaks", "--fade"])):
        path = tmp_path / f"{number}.png"
        style = argv("--style window --size 640x400 --out")
        assert main(["render", str(result), *style, str(path), *words]) == 0
        pictures.append(np.asarray(Image.open(path)).astype(int))
    plain, full, faded = pictures
    assert 0.1 < np.abs(faded - plain).mean() < np.abs(full - plain).mean()


def test_render_tells_machines_of_every_frame(result, tmp_path, capsys):
    words = ["--size", "320x240", "--seconds", "0.3", "--fps", "10", "--progress"]
    assert main(["render", str(result), "--out", str(tmp_path / "a.mp4"), *words]) == 0
    *frames, last = capsys.readouterr().out.splitlines()
    assert [json.loads(line) for line in frames] == [
        {"frame": frame, "count": 3} for frame in (1, 2, 3)
    ]
    assert last.startswith("wrote ")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("a.png --time -0.5", "--time is -0.5; expected 0 to 2, which is 2 tau"),
        ("a.png --time 0.5 --time 2.5", "--time is 2.5; expected 0 to 2"),
        ("a.png --time nan", "--time is nan"),
        ("a.png --style window --time 0 --time 1", "--time is given more than once"),
        ("a.png --transparent", "--transparent is not for sheets; add --style window"),
        ("a.png --no-labels", "--no-labels is not for sheets"),
        ("a.png --streaks", "--streaks is not for sheets"),
        ("a.mp4 --fade", "--fade is for streaks; add --streaks"),
        ("a.png --fps 30", "--fps is for movies"),
        ("a.png --style window --size 9000x9000", "16 to 8192"),
        ("a.mp4 --to 3", "--to is 3; expected 0 to 2"),
        ("a.mp4 --from -1", "--from is -1"),
        ("a.mp4 --time 1", "--time is for pictures"),
        ("a.mp4 --style sheet", "--style sheet is for pictures"),
        ("a.mp4 --transparent", "--transparent is for pictures"),
        ("a.mp4 --seconds 0", "--seconds"),
        ("a.gif --fps 60", "--fps 60: a .gif file takes 0.1 to 50"),
    ],
)
def test_render_refuses_what_would_make_no_sense(words, expected, result, tmp_path, capsys):
    out, *others = words.split()
    assert main(["render", str(result), "--out", str(tmp_path / out), *others]) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_render_has_no_sheet_of_a_project_without_a_result(project, tmp_path, capsys):
    document, known = load_project(project)
    path = tmp_path / "unsolved.abfm"
    save_project(path, replace(document, result=None), known)
    assert main(["render", str(path), "--style", "sheet", "--out", str(tmp_path / "a.png")]) == 2
    assert "holds no result to make a sheet of" in capsys.readouterr().err
    assert main(["render", str(path), "--size", "320x240", "--out", str(tmp_path / "a.png")]) == 0


def test_a_damaged_result_is_refused(tmp_path, capsys):
    path = tmp_path / "m.npz"
    path.write_bytes(b"PK\x03\x04 not a zip")
    assert main(["render", str(path), "--out", str(tmp_path / "a.png")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_demo_passes_its_own_test(tmp_path, capsys):
    out = tmp_path / "made" / "here"
    assert main(["demo", "--out", str(out), "--json", "--quiet"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["mismatch"] <= 0.05
    assert sorted(path.name for path in out.iterdir()) == ["demo.mp4", "demo.npz", "demo.png"]
    assert report["movie"] == str(out / "demo.mp4")
    with Image.open(out / "demo.png") as image:
        assert image.width == DEFAULT_WIDTH
    with av.open(str(out / "demo.mp4")) as movie:
        assert len(list(movie.decode(video=0))) == 50


def test_demo_fails_when_the_mismatch_stays_high(tmp_path, capsys, monkeypatch):
    def no_picture(match):
        raise DrawingError("no time for it")

    monkeypatch.setattr("abfm_viewer.cli.demo.Parameters", lambda: Parameters(iterations=1))
    monkeypatch.setattr("abfm_viewer.pictures.match_picture", no_picture)
    assert main(["demo", "--out", str(tmp_path), "--quiet"]) == 1
    told = capsys.readouterr().err
    assert "note: no picture and no movie: no time for it\n" in told
    assert "the self-test failed" in told


def test_bench_prints_its_report_for_people_and_machines(capsys, monkeypatch):
    small = {"subdivision": 2, "subdivisions": (1, 2), "iterations": 20, "repeats": 1, "timings": 1}
    monkeypatch.setattr(laboratory, "Settings", partial(laboratory.Settings, **small))
    assert main(["bench", "--seconds", "0.3", "--json"]) == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert report["settings"]["seconds"] == 0.3
    assert set(report["ratios"]["gradient_to_advection"]) == {"42", "162"}
    assert "cosines" in captured.err
    assert main(["bench", "--seconds", "0.3", "--quiet"]) == 0
    captured = capsys.readouterr()
    assert "finest / coarsest" in captured.out
    assert captured.err == ""


def test_bench_counts_successes_on_given_meshes(capsys):
    success = ["bench", "--success", "--only-given", "--mesh", EIGHT, "--problems", "1"]
    assert main([*success, "--json"]) == 0
    captured = capsys.readouterr()
    (row,) = json.loads(captured.out)["rows"]
    assert row["problem"]["mesh"] == "eight.off"
    assert {"before", "now"} <= row.keys()
    assert "1/1 eight.off" in captured.err
    assert main([*success, "--quiet"]) == 0
    captured = capsys.readouterr()
    assert "of 1" in captured.out
    assert captured.err == ""
    assert main([*success, "--mesh", EIGHT]) == 2
    assert "two meshes are called eight.off" in capsys.readouterr().err

"""The command line, run in this process."""

import json
import re
import shlex
import shutil
from dataclasses import asdict, replace
from functools import partial
from unittest.mock import Mock

import av
import numpy as np
import pytest
import trimesh
from PIL import Image, ImageSequence
from scipy.spatial.transform import Rotation

from abfm import Parameters, load
from abfm.assets import asset_path
from abfm.io import write_values
from abfm.matching.judging.cause import Cause
from abfm.matching.report import path_lines
from abfm.matching.task import MatchTask
from abfm.parameters import FIELDS, MAIN_FIELDS
from abfm.workers import progress
from abfm_viewer.cli import main
from abfm_viewer.cli.options import Parser
from abfm_viewer.errors import DrawingError
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.pictures.sheets import DEFAULT_WIDTH
from abfm_viewer.session.session_files import document_of_result
from benchmarks import solver
from tests.mesh_writers import freesurfer_bytes, off_text
from tests.messages import check_message, line_with
from tests.processes import argv
from tests.shapes import icosphere
from tests.viewer.sessions import EGG, SPHERE

HUMAN, EIGHT = (str(asset_path(f"{name}.off")) for name in ("human_A", "eight"))
PAIR = ["--source=gaussian:vertex=10,width=0.2", "--target=gaussian:vertex=40,width=0.2"]
SHORT = ["--set=iterations=6", "--refine=0", "--quiet"]
MATCH = ["match", EIGHT, *PAIR, *SHORT, "--out"]
SHORT_BENCH = ["bench", "--success", "--problems=1"]
UNREACHED = 3  # the exit status of runs that are too short to arrive


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A result file of two channels."""
    path = tmp_path_factory.mktemp("result") / "m.npz"
    channel = ["--channel", "coordinate:x", "coordinate:y", "0.01"]
    assert main(argv(*MATCH, path, *channel)) == UNREACHED
    return path


@pytest.fixture(scope="module")
def project(result, tmp_path_factory):
    """The result as a project."""
    path = tmp_path_factory.mktemp("project") / "m.abfm"
    save_project(path, *document_of_result(load(result), result))
    return path


def pixels(path):
    return np.asarray(Image.open(path)).astype(int)


@pytest.mark.parametrize("words", [["--help"], ["match", "--help"], ["--version"]])
def test_help_and_version_end_well_and_help_names_every_parameter(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(argv(*words))
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "abfm" in out
    if "match" in words:
        assert "abfm match spot.obj --source" in out
        assert set(FIELDS) <= {*re.split(r"[\s,]+", out.replace("--", "").replace("-", "_"))}
        for entry in MAIN_FIELDS.values():
            assert not entry.metadata["symbol"] or f"[{entry.metadata['symbol']}]" in out
        for said in ("status is 0 when source and target are matched", "; 3 when the target was"):
            assert said in " ".join(out.split())


def test_without_words_all_commands_are_shown_and_argparse_reaches_their_parsers(abfm):
    out = abfm().out
    for command in ("match", "demo", "figure", "map", "render", "info", "bench"):
        assert f"\n    {command} " in out
    commands = Parser(prog="abfm", description="").add_subparsers()
    # Python 3.14: color
    assert commands.add_parser("match", description="", epilog="the end").epilog == "the end"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["mtach"], ("match",)),
        (["info"], ("MESH",)),
        (["info", EIGHT, "--jsno"], ("--json",)),
        (["info", "missing.off"], ("missing.off",)),
        (["info", __file__], ()),
        (["match", EIGHT, *PAIR], ("--out",)),
        (["match", EIGHT, "--out", "m.npz"], ("source", "target")),
        (["match", EIGHT, "--source", "coordinate:x", "--out", "m.npz"], ()),
        (["match", EIGHT, *PAIR, "--out", "m.txt"], (".npz", ".ply", ".vtu", ".csv")),
        (["match", EIGHT, *PAIR, "--out", "none/m.npz"], ("none",)),
        ([*MATCH, "m.npz", "--tau", "-1"], ("tau", "-1.0", 0)),
        ([*MATCH, "m.npz", "--tau", "soon"], ("--tau",)),
        ([*MATCH, "m.npz", "--sigma", "soon"], ("--sigma", "soon")),
        ([*MATCH, "m.npz", "--refine", "9"], ("refine", 9, 0)),
        ([*MATCH, "m.npz", "--path", "p.txt"], (".csv",)),
        ([*MATCH, "m.csv", "--path", "m.csv"], ()),
        (
            [*MATCH, "m.npz", "--max-distortion", "-1"],
            (-1, 0, 1000),
        ),
        ([*MATCH, "m.npz", "--set=method=linear"], ("method", "linear", "linearised")),
        ([*MATCH, "m.npz", "--set", "levels=11"], ("levels", 11, 10)),
        ([*MATCH, "m.npz", "--set", "levles=1"], ("levels",)),
        ([*MATCH, "m.npz", "--set", "alpha=1"], ("--alpha",)),
        ([*MATCH, "m.npz", "--levels", "2"], ("--set levels=",)),
        ([*MATCH, "m.npz", "--sgima", "1"], ("--sigma",)),
        ([*MATCH, "m.npz", "--channel", "coordinate:x", "coordinate:y", "z"], ("z",)),
        ([*MATCH, "m.npz", "--mask", "file:none.npy"], ("none.npy",)),
        ([*MATCH, "m.npz", "--start", "none.npz"], ("none.npz",)),
        ([*MATCH, "m.npz", "--source", "gausian:vertex=1"], ("gaussian",)),
        ([*MATCH, "m.npz", "--source", "gaussian:vertex=999"], (315,)),
        (["bench", "--seconds", "0"], (0,)),
        (
            ["bench", "--success", "--problems=0"],
            (1, 1000000),
        ),
        ([*SHORT_BENCH, "--json", "none/b.json"], ("none",)),
        ([*SHORT_BENCH, "--meshes", EIGHT], ("eight.off",)),
        ([*SHORT_BENCH, "--only-given"], ("--meshes",)),
        ([*SHORT_BENCH, "--meshes", EIGHT, "a mesh.off"], ("mesh.off",)),
        ([*SHORT_BENCH, "--jobs=1", "--scheduler=tcp://127.0.0.1:1"], ("--scheduler",)),
        ([*SHORT_BENCH, "--seconds=1"], ("--seconds",)),
        ([*SHORT_BENCH, "--arrival"], ("--arrival",)),
        (["bench", "--arrival", "--jobs=2"], ("--jobs",)),
        (["bench", "--measured", "--problems=1", "--solvable"], ("--success",)),
        (["bench", "--seconds=0.1", "--only-given"], ("--only-given",)),
        (["info", "none.npz"], ("none.npz",)),
        (["render", "none.npz", "--out", "a.png"], ("none.npz",)),
        (["render", "none.abfm", "--out", "a.mp4"], ("none.abfm",)),
        (["render", "none.npz", "--out", "a.jpg"], (".png", ".mp4", ".gif")),
        (["render", "none.npz", "--out", "a.png", "--size", "10x10"], ("320x240",)),
        (["render", "none.npz", "--out", "a.png", "--size", "large"], ("size",)),
    ],
)
def test_bad_input_is_one_clear_line_and_status_2(words, named, abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = abfm(*words, status=2)
    assert told.out == ""
    check_message(told.err, *named)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("m.ply", ["m.ply", *PAIR, "--out", "m.ply"]),
        (
            "f.csv",
            [EIGHT, "--source=file:f.csv+geodesic:vertex=0", "--target=file:g.csv", "--out=f.csv"],
        ),
        (
            "f.csv",
            [
                EIGHT,
                *PAIR,
                "--channel",
                "coordinate:x",
                "file:f.csv,column=1",
                "1",
                "--out=a.npz",
                "--path=f.csv",
            ],
        ),
        ("f.csv", [EIGHT, *PAIR, "--mask", "f.csv", "--out", "f.csv"]),
    ],
)
def test_what_is_read_is_not_replaced_by_what_is_found(name, words, tmp_path, abfm, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("theirs")
    check_message(abfm("match", *words, status=2).err, name)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["theirs"]


def test_meshes_are_refused_with_the_way_out_and_to_machines_too(tmp_path, abfm):
    spheres = [trimesh.creation.icosphere(2, radius=radius) for radius in (1.0, 0.3)]
    spheres[1].apply_translation([3, 0, 0])
    path = tmp_path / "two.off"
    trimesh.util.concatenate(spheres).export(path)
    assert "--largest-component" in abfm("info", path, status=2).err
    facts = json.loads(abfm("info", path, "--largest-component", "--json").out)
    assert facts["vertices"] == 162
    assert facts["messages"]
    path = tmp_path / "fan.off"
    path.write_text("OFF\n5 3 0\n0 0 0\n0 0 1\n1 0 0\n-1 1 0\n-1 -1 0\n3 0 1 2\n3 0 1 3\n3 0 1 4\n")
    told = abfm("info", path, "--json", status=2)
    facts = json.loads(told.out)
    assert facts["usable"] is False
    assert told.err == f"abfm: {facts['objection']}\n"


def test_meshes_are_merged_and_cleaned_in_every_command(tmp_path, abfm):
    """Values of all vertices of the file fit, and what is written has its length."""
    sphere = icosphere(1)
    corners = np.concatenate([sphere.faces, sphere.faces[:1]]).ravel()
    path, values, out = (tmp_path / name for name in ("split.off", "x.npy", "m.npz"))
    path.write_text(off_text(sphere.vertices[corners], np.arange(len(corners)).reshape(-1, 3)))
    of_corners = sphere.vertices[corners, 0]
    of_corners[-1] += 1  # of a copy
    np.save(values, of_corners)
    assert "--merge --clean" in abfm("info", path, status=2).err
    for words in (["--merge", path, "--clean"], [path, "--clean", "--merge=1e-9"]):
        assert json.loads(abfm("info", *words, "--json").out)["vertices"] == 42
    assert "0.9" in abfm("info", "--merge", "0.9", path, status=2).err
    assert "near" in abfm("info", path, "--merge=near", status=2).err
    assert "L or R" in abfm("info", path, "--hemisphere", "left", status=2).err
    given = [f"--source=file:{values}", f"--target=file:{values}", "--merge", "--clean", *SHORT]
    assert "warning: 1 of 201 merged" in abfm("match", path, *given, "--out", out).err
    mesh = load(out).mesh
    assert mesh.on_file(mesh.vertices[:, 0]) == pytest.approx(sphere.vertices[corners, 0])
    abfm("map", out, "--out", tmp_path / "map.txt")
    assert (mesh.local_vertices(np.loadtxt(tmp_path / "map.txt")) == mesh.numbered[1]).all()
    table = tmp_path / "t.csv"
    row = f"{path},{path},coordinate:x,coordinate:x,yes,yes,3,0"
    table.write_text(f"a,b,source,target,merge,clean,iterations,refine\n{row}\n")
    abfm("batch", table, "--out", tmp_path / "b", "--jobs=1", "--quiet")


def test_match_reports_and_writes_what_it_found(tmp_path, abfm):
    out = tmp_path / "m.npz"
    words = [
        "match",
        EIGHT,
        *PAIR,
        "--set=iterations=20",
        "--refine=0",
        "--beta=0",
        "--json",
        f"--out={out}",
    ]
    told = abfm(*words, status=UNREACHED)
    report, match = json.loads(told.out), load(out)
    assert report["mesh"] == EIGHT
    assert report["outputs"] == [str(out)]
    assert report["iterations"] == len(match.energy_history) - 1 <= 20
    for name in ("residual", "mismatch", "stop_reason", "verified_residual", "folded"):
        assert report[name] == getattr(match, name)
    assert report["energy"]["total"] == match.energy_history[-1, 0]
    assert report["parameters"] == match.parameters.to_dict()
    assert (report["parameters"]["iterations"], report["parameters"]["beta"]) == (20, 0)
    assert report["verdict"] == json.loads(json.dumps(asdict(match.verdict)))
    remedies = [remedy["label"] for remedy in report["verdict"]["remedies"]]
    assert remedies == ["More time", "Continue"]
    first = r"^iteration 0  (mesh 2/2, )?stage 1(, reach [\d.]+)?  energy [\d.]+  residual [\d.]+$"
    assert re.search(first, told.err, re.M)
    assert match.source.shape == (315, 1)
    assert match.advect(0.5).shape == (315,)


def test_match_says_the_outcome_in_a_few_lines_and_what_to_try(tmp_path, abfm):
    out = tmp_path / "m.npz"
    told = abfm(*MATCH, out, status=UNREACHED)
    match = load(out)
    assert told.err == ""
    said, why, numbers, *table, wrote, advice = told.out.splitlines()
    assert said == match.facts.headline
    assert why == match.facts.reason
    known = f"residual {match.residual:.3g}, {match.verified_residual:.3g} by flow lines, "
    assert numbers.startswith(known)
    assert wrote.endswith(f" s; wrote {out}")
    assert table == (path_lines(match) if len(match.path) > 1 else [])
    assert MatchTask.report.advice(match, str(out)) in advice
    said = abfm(*MATCH, tmp_path / "m.npz", "--source", "expression:1", status=UNREACHED).out
    said, why, *_, advice = said.splitlines()
    assert said.startswith("impossible")
    check_message(why)
    check_message(advice)


def test_measured_functions_that_are_registered_are_a_success(tmp_path, abfm):
    """Waves and the same waves turned by seven degrees, each with noise of its own."""
    mesh, out, noise = tmp_path / "sphere.off", tmp_path / "m.npz", np.random.default_rng(0)
    trimesh.Trimesh(SPHERE.vertices, SPHERE.faces, process=False).export(mesh)
    turned = SPHERE.vertices @ Rotation.from_rotvec([0, 0, 0.12]).as_matrix()
    for name, (x, y, z) in (("f", SPHERE.vertices.T), ("g", turned.T)):
        waves = np.sin(7 * x + 1) * np.sin(6 * y) + np.cos(8 * z + 2 * x)
        np.save(tmp_path / name, waves + 0.25 * noise.standard_normal(len(x)))
    given = [f"--{side}=file:{tmp_path}/{f}.npy" for side, f in (("source", "f"), ("target", "g"))]
    said, why, *_ = abfm("match", mesh, "--quiet", "--out", out, *given).out.splitlines()
    check_message(said, "registered")
    assert load(out).verdict.cause is Cause.LIMIT_OF_DATA
    first = load(out).initial_residual
    assert float(re.findall(r"([\d.]+)%", why)[-1]) == pytest.approx(100 * first, abs=1)
    assert said in abfm("info", out).out


def test_what_is_advised_on_the_command_line_can_be_typed_there_and_helps(tmp_path, abfm):
    """A source that nothing leads to its target is warned of while it runs, once."""
    mesh, out = tmp_path / "egg.off", tmp_path / "m.npz"
    trimesh.Trimesh(EGG.vertices, EGG.faces, process=False).export(mesh)
    far = [
        "--source=gaussian:x=0,y=0,z=1,width=0.1",
        "--target=gaussian:x=0.5,y=0,z=-0.87,width=0.1",
    ]
    words = [
        "match",
        mesh,
        *far,
        "--set=reach=0",
        "--refine=1",
        "--set=iterations=40",
        "--quiet",
        f"--out={out}",
    ]
    told = abfm(*words, status=UNREACHED)
    assert "\nthe flow squeezed the source to nothing" in told.out
    warning = r"warning: iteration \d+: the source is being squeezed to nothing .*\n"
    assert re.fullmatch(warning, told.err)
    options = shlex.split(re.search(r"^to try: reach further \((.*?)\)$", told.out, re.M)[1])
    before = load(out).residual
    abfm(*words, *options)
    assert load(out).residual < 0.2 * before


def test_progress_tells_meshes_stages_and_reach(tmp_path, abfm):
    words = [
        "match",
        HUMAN,
        *PAIR,
        "--set=iterations=40",
        "--set=levels=2",
        "--set=reach=0.4",
        f"--out={tmp_path}/m.npz",
    ]
    said = abfm(*words).err
    # thin triangles: the mesh itself comes twice
    assert "iteration 0  mesh 1/3, stage 1, reach 0.4  energy" in said
    assert "  mesh 2/3, stage " in said


def test_info_reports_long_steps(abfm, monkeypatch):
    slow = "reading", "looking for symmetries"
    monkeypatch.setattr(progress, "_rates", dict.fromkeys(slow, (1.0, 0)))
    lines = abfm("info", EIGHT).err.splitlines()
    assert [line.partition(", about")[0] for line in lines] == ["reading an OFF mesh", slow[1]]
    assert abfm("info", EIGHT, "--quiet").err == ""


@pytest.mark.parametrize(("extra", "is_told"), [([], True), (["--quiet"], False)])
def test_what_takes_seconds_is_said_with_an_estimate(extra, is_told, tmp_path, monkeypatch, capsys):
    slow = ("factoring for distances", "checking by flow lines")
    monkeypatch.setattr(progress, "_rates", dict.fromkeys(slow, (1.0, 0)))
    pair = [
        "--source=gaussian:vertex=0",
        "--target=gaussian:vertex=300",
        "--set=iterations=5",
        "--refine=0",
        "--set=levels=1",
    ]
    main(argv("match", EIGHT, *pair, "--out", tmp_path / "match.npz", *extra))
    said = capsys.readouterr().err
    assert all((f"{name}, about " in said) is is_told for name in slow)
    assert "factoring a system" not in said  # nobody knows for how long, which is short here


def test_channels_and_weights_reach_the_solver_and_what_is_not_known_is_null(result):
    match = load(result)
    assert match.source.shape == (315, 2)
    assert match.weights == pytest.approx([1, 0.01])
    assert match.target[:, 1] == pytest.approx(match.mesh.vertices[:, 1])
    match = replace(match, verified_residual=float("nan"), folded=float("nan"))
    details = MatchTask.report.details(match)
    assert details["verified_residual"] is details["folded"] is None
    assert "flow lines" not in MatchTask.report.lines(match)[0]


@pytest.mark.parametrize("as_file", [False, True])
def test_a_mask_is_a_function_or_its_file(as_file, tmp_path, abfm):
    out, values = tmp_path / "m.npz", tmp_path / "a mask, 1.npy"
    np.save(values, np.linspace(0, 1, 315))
    abfm(*MATCH, out, "--mask", values if as_file else "expression:1+x*x", status=UNREACHED)
    match = load(out)
    expected = np.linspace(0, 1, 315) if as_file else 1 + match.mesh.vertices[:, 0] ** 2
    assert match.mask == pytest.approx(expected)


def test_a_warm_start_begins_where_the_earlier_result_ended(tmp_path, abfm, result):
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    one_stage = ["--set=cooling_stages=1", "--set=reach=0", "--set=levels=1"]
    abfm(*MATCH, first, *one_stage, "--set=iterations=8", status=UNREACHED)
    abfm(*MATCH, second, *one_stage, "--set=iterations=1", "--start", first, status=UNREACHED)
    energies = [load(path).energy_history for path in (first, second)]
    assert energies[1][0] == pytest.approx(energies[0][-1])
    words = ["match", HUMAN, *PAIR, "--start", result, "--out", tmp_path / "m.npz"]
    check_message(abfm(*words, status=2).err)


def test_exports_hold_the_functions_and_the_field(tmp_path, abfm):
    npz, ply, vtu, csv = paths = [tmp_path / f"m.{end}" for end in ("npz", "ply", "vtu", "csv")]
    words = ["match", EIGHT, *PAIR, *SHORT, "--set=method=linearised", "--set=segments=2"]
    abfm(*words, *(f"--out={path}" for path in paths), status=UNREACHED)
    match = load(npz)
    attributes = trimesh.load(ply, process=False).metadata["_ply_raw"]
    assert attributes["vertex"]["data"]["advected"].ravel() == pytest.approx(match.advected[:, 0])
    field = attributes["face"]["data"]["velocity_segment_1_2"]
    assert field.ravel() == pytest.approx(match.velocity[1, :, 2])
    text = vtu.read_bytes()
    for name in ("source", "target", "advected", "velocity_segment_0", "velocity_segment_1"):
        assert f'Name="{name}"'.encode() in text
    rows = csv.read_text().splitlines()
    assert rows[0] == "iteration,stage,total,regularity,mismatch"
    assert len(rows) == len(match.energy_history) + 1


def test_info_knows_surfaces_of_freesurfer_and_what_is_none(abfm, tmp_path):
    path, sphere = tmp_path / "lh.sphere.reg", icosphere(1)
    path.write_bytes(freesurfer_bytes(sphere.vertices, sphere.faces))
    facts = json.loads(abfm("info", path, "--json").out)
    assert (facts["vertices"], facts["faces"], facts["genus"]) == (42, 80, 0)
    write_values(tmp_path / "lh.sulc", sphere.vertices[:, 0])
    told = abfm("info", tmp_path / "lh.sulc", status=2).err
    check_message(told, "lh.sulc")


def test_info_tells_the_facts_of_a_mesh_and_its_symmetries(abfm):
    text = abfm("info", EIGHT).out
    for word in ("315", "634", "951", "genus         2", "none (closed)", "no objection"):
        assert word in text
    facts = json.loads(abfm("info", EIGHT, "--json").out)
    assert (facts["vertices"], facts["faces"], facts["edges"], facts["genus"]) == (315, 634, 951, 2)
    assert facts["usable"] is True
    assert facts["boundary_loops"] == 0
    lengths = facts["edge_lengths"]
    assert facts["edge_ratio"] == pytest.approx(lengths["longest"] / lengths["shortest"])
    assert facts["length_scale"] ** 2 == pytest.approx(facts["area"])
    text = abfm("info", HUMAN).out
    check_message(line_with(text, "mirror"), "1 0 0")
    check_message(line_with(text, "rotation"))
    symmetries = json.loads(abfm("info", HUMAN, "--json").out)["symmetries"]
    assert symmetries["rotation"] is None
    assert symmetries["mirror"]["is_permutation"] is True
    assert symmetries["mirror"]["error"] < 1e-9
    assert symmetries["mirror"]["axis"] == pytest.approx([1, 0, 0])


def test_names_that_cannot_be_printed_stay_on_their_lines(tmp_path, capsys):
    folder = tmp_path / "a\nb\x1b[31m"
    folder.mkdir()
    mesh, result, table, picture = (str(folder / f"c\n.{s}") for s in ("off", "npz", "txt", "png"))
    shutil.copy(EIGHT, mesh)
    match = ["match", mesh, *PAIR, *SHORT, "--out", result]
    render = ["render", result, "--out", picture, "--size", "320x240"]
    for words, status, told in (
        (["info", mesh], 0, "/a?b?[31m/c?.off"),
        (match, UNREACHED, "--start {}/a?b?[31m/c?.npz"),
        (["map", result, "--out", table], 0, "wrote {}/a?b?[31m/c?.txt"),
        (render, 0, "wrote {}/a?b?[31m/c?.png (320 x 240)"),
    ):
        assert main(words) == status
        lines = capsys.readouterr().out.splitlines()
        assert all(line.isprintable() for line in lines)
        assert told.format(tmp_path) in "".join(lines)


def test_render_draws_and_tells_what_was_asked_for(result, tmp_path, abfm, project):
    words = [
        "render",
        result,
        f"--out={tmp_path}/a.png",
        "--size=800x400",
        "--time=0.5",
        "--channel",
    ]
    assert f"{tmp_path}/a.png" in abfm(*words, "1", "--up", "z").out
    assert pixels(tmp_path / "a.png").shape[:2] == (400, 800)
    check_message(abfm(*words, "2", status=2).err, 0, 1)
    picture = tmp_path / "a.png"
    words = ["render", project, "--out", picture, "--size", "400x300"]
    assert abfm(*words, "--transparent").out == f"wrote {picture} (400 x 300)\n"
    shown = pixels(picture)
    assert shown.shape == (300, 400, 4)
    assert (shown[..., 3].min(), shown[..., 3].max()) == (0, 255)
    abfm(*words, "--no-color-bar", "--no-labels", "--channel", "1", "--up=z", "--time=0")
    assert pixels(picture).shape == (300, 400, 3)
    for style in ("sheet", "window"):
        pictures = [tmp_path / f"{style}{number}.png" for number in range(2)]
        for path, picture in zip((result, project), pictures, strict=True):
            abfm("render", path, "--style", style, "--size", "640x400", "--out", picture)
        assert (pixels(pictures[0]) == pixels(pictures[1])).all()
    words = ["--size", "320x240", "--seconds", "0.3", "--fps", "10", "--progress"]
    *frames, last = abfm("render", result, "--out", tmp_path / "a.mp4", *words).out.splitlines()
    assert list(map(json.loads, frames)) == [{"frame": n, "count": 3} for n in (1, 2, 3)]
    assert last.startswith("wrote ")


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_render_writes_movies(suffix, result, project, tmp_path, abfm):
    for path in (result, project):
        movie = tmp_path / f"{path.stem}{suffix}"
        words = ["--size=330x240", "--seconds=0.5", "--fps=8", "--to=2", "--turntable=-90"]
        told = abfm("render", path, "--out", movie, *words)
        assert told.out == f"wrote {movie} (330 x 240, 4 frames)\n"
        assert told.err == "".join(f"frame {frame} of 4\n" for frame in (1, 2, 3, 4))
        with av.open(str(movie)) as file:
            frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert (len(frames), frames[0].shape) == (4, (240, 330, 3))
        assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


@pytest.mark.usefixtures("coarse_streaks")
def test_render_draws_streaks_that_move_in_a_loop_or_fade(result, tmp_path, abfm):
    """Frames at one time differ by the streaks alone, from the last to the first as elsewhere."""
    gif = tmp_path / "a.gif"
    words = ["--streaks", "--from=1", "--to=1", "--seconds=0.4", "--fps=10", "--size=320x240"]
    abfm("render", result, "--out", gif, *words)
    with Image.open(gif) as movie:
        assert (movie.n_frames, movie.info["loop"]) == (4, 0)
        every = ImageSequence.Iterator(movie)
        frames = [np.asarray(frame.convert("RGB")).astype(int) for frame in every]
    steps = [np.abs(frames[i] - frames[i - 1]).mean() for i in range(4)]
    assert 0.1 < max(steps) < 1.5 * min(steps)
    for number, words in enumerate(([], ["--streaks"], ["--streaks", "--fade"])):
        style = ["--style=window", "--size=640x400", f"--out={tmp_path}/{number}.png"]
        abfm("render", result, *style, *words)
    plain, full, faded = (pixels(tmp_path / f"{number}.png") for number in range(3))
    assert 0.1 < np.abs(faded - plain).mean() < np.abs(full - plain).mean()


@pytest.mark.parametrize(
    ("name", "words", "named"),
    [
        ("a.png", ["--time", "-0.5"], ("--time", "-0.5", 0, 2)),
        ("a.png", ["--time", "0.5", "--time", "2.5"], ("--time", "2.5", 0, 2)),
        ("a.png", ["--time", "nan"], ("--time", "nan")),
        (
            "a.png",
            ["--style", "window", "--time", "0", "--time", "1"],
            ("--time",),
        ),
        ("a.png", ["--transparent"], ("--transparent", "--style")),
        ("a.png", ["--no-labels"], ("--no-labels",)),
        ("a.png", ["--streaks"], ("--streaks",)),
        ("a.mp4", ["--fade"], ("--fade", "--streaks")),
        ("a.png", ["--fps", "30"], ("--fps",)),
        ("a.png", ["--style", "window", "--size", "9000x9000"], (16, 8192)),
        ("a.mp4", ["--to", "3"], ("--to", 3, 0, 2)),
        ("a.mp4", ["--from", "-1"], ("--from", -1)),
        ("a.mp4", ["--time", "1"], ("--time",)),
        ("a.mp4", ["--style", "sheet"], ("--style", "sheet")),
        ("a.mp4", ["--transparent"], ("--transparent",)),
        ("a.mp4", ["--seconds", "0"], ("--seconds",)),
        ("a.gif", ["--fps", "60"], ("--fps", 60, ".gif", "0.1", 50)),
    ],
)
def test_render_refuses_what_would_make_no_sense(name, words, named, result, tmp_path, abfm):
    check_message(
        abfm("render", result, "--out", f"{tmp_path}/{name}", *words, status=2).err, *named
    )
    assert list(tmp_path.iterdir()) == []


def test_render_refuses_a_project_without_a_result_and_a_damaged_one(project, tmp_path, abfm):
    document, known = load_project(project)
    save_project(tmp_path / "unsolved.abfm", replace(document, result=None), known)
    words = ["render", tmp_path / "unsolved.abfm", "--out", tmp_path / "a.png"]
    check_message(abfm(*words, "--style", "sheet", status=2).err)
    abfm(*words, "--size", "320x240")
    (tmp_path / "m.npz").write_bytes(b"PK\x03\x04 not a zip")
    abfm("render", tmp_path / "m.npz", "--out", tmp_path / "a.png", status=2)


def test_demo_passes_its_own_test_and_fails_when_mismatch_stays_high(tmp_path, abfm, monkeypatch):
    out = tmp_path / "made" / "here"
    monkeypatch.setattr("abfm_viewer.cli.demo._FRAMES", 5)
    report = json.loads(abfm("demo", "--out", out, "--json", "--quiet").out)
    assert report["mismatch"] <= 0.05
    assert sorted(path.name for path in out.iterdir()) == ["demo.mp4", "demo.npz", "demo.png"]
    assert report["movie"] == str(out / "demo.mp4")
    assert pixels(out / "demo.png").shape[1] == DEFAULT_WIDTH
    with av.open(str(out / "demo.mp4")) as movie:
        assert len(list(movie.decode(video=0))) == 5
    no_picture = Mock(side_effect=DrawingError("no time for it"))
    monkeypatch.setattr(
        "abfm_viewer.cli.demo.Parameters", lambda: Parameters.of(iterations=1, refine=0)
    )
    monkeypatch.setattr("abfm_viewer.pictures.match_picture", no_picture)
    told = abfm("demo", "--out", tmp_path, "--quiet", status=1).err
    check_message(line_with(told, "no time for it"), "note")
    check_message(told.splitlines()[-1])


def test_bench_prints_its_report_and_counts_successes(abfm, monkeypatch, tmp_path):
    small = {"subdivision": 2, "subdivisions": (1, 2), "iterations": 20, "repeats": 1, "timings": 1}
    monkeypatch.setattr(solver, "Settings", partial(solver.Settings, **small))
    told = abfm("bench", "--seconds", "0.1", "--json")
    report = json.loads(told.out)
    assert report["settings"]["seconds"] == 0.1
    assert set(report["ratios"]["gradient_to_advection"]) == {"42", "162"}
    assert "cosines" in told.err
    monkeypatch.setattr(solver, "run", lambda tell, _: tell("a line") or report)
    told = abfm("bench", "--quiet")
    assert "finest / coarsest" in told.out
    assert told.err == ""
    trials = tmp_path / "trials"
    success = [
        "bench",
        "--success",
        "--only-given",
        "--problems=1",
        "--jobs=1",
        f"--out={trials}",
        "--meshes",
        EIGHT,
    ]
    told = abfm(*success, "--json")
    (row,) = json.loads(told.out)["rows"]
    assert row["problem"]["mesh"] == "eight.off"
    assert row.keys() == {"problem", "result"}
    assert "1/1 eight.off" in told.err
    told = abfm(*success, "--quiet", "--json", tmp_path / "b.json")
    assert "1 of 1" in told.out
    assert told.err == ""
    (again,) = json.loads((tmp_path / "b.json").read_text())["rows"]
    assert again == row  # read, with its seconds
    assert len([*trials.glob("*.npz")]) == 1
    check_message(abfm(*success, EIGHT, status=2).err, "eight.off")


def test_bench_measures_errors_of_maps(abfm, monkeypatch):
    monkeypatch.setattr("benchmarks.map_errors.SIGMAS", (3.0,))
    told = abfm(
        "bench",
        "--measured",
        "--jobs=1",
        "--only-given",
        "--problems=1",
        "--meshes",
        EIGHT,
        "--json",
    )
    (row,) = json.loads(told.out)["rows"]
    assert row["fixed"].keys() == {"3"}
    assert "1/1 eight.off" in told.err

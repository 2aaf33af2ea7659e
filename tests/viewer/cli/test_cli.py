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
from PIL import Image

from abfm import Parameters, load
from abfm.explanations import names as section_names
from abfm.explanations import slug
from abfm.functions import families
from abfm.matching.task import MatchTask
from abfm.parameters import FIELDS, MAIN_FIELDS
from abfm.wording import share
from abfm.workers import progress
from abfm.workers.progress import Step
from abfm_viewer.cli import commands, main
from abfm_viewer.cli.options import Parser
from abfm_viewer.cli.progress import TaskProgress
from abfm_viewer.errors import DrawingError
from abfm_viewer.files.documents import document_of_result
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.pictures.sheets import DEFAULT_WIDTH
from benchmarks import map_errors, solver, success
from tests.mesh_writers import off_text
from tests.messages import check_message, check_names, line_with
from tests.processes import words_of
from tests.shapes import icosphere
from tests.viewer.cli.conftest import MESHES
from tests.viewer.sessions import EGG

PAIR = "--source=gaussian:vertex=10,width=0.2 --target=gaussian:vertex=40,width=0.2"
SHORT_RUN = "--set=iterations=6 --refine=0 --quiet"
MATCH = f"match {{eight}} {PAIR} {SHORT_RUN}"
UNREACHED = 3  # exit status of matches with too few iterations


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "m.npz"
    line = f"{MATCH} --channel coordinate:x coordinate:y 0.01 --out {{path}}"
    assert main(words_of(line, path=path, **MESHES)) == UNREACHED
    return path


@pytest.fixture(scope="module")
def project(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("project") / "m.abfm"
    save_project(path, *document_of_result(load(result), result))
    return path


def pixels(path):
    return np.asarray(Image.open(path)).astype(int)


def help_text(line, capsys):
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 0
    return capsys.readouterr().out


def option_names(text):
    return re.findall(r"^  (?:-h, )?--([\w-]+)", text, re.MULTILINE)


@pytest.mark.parametrize("line", ["--help", "--version"])
def test_help_and_version_are_printed(line, capsys):
    assert "abfm" in help_text(line, capsys)


def test_complete_help_lists_options_families_and_statuses(capsys):
    text = help_text("match --help-all", capsys)
    words = {*re.split(r"[\s,=]+", text.replace("--", "").replace("-", "_"))}
    assert set(FIELDS) <= words
    for entry in MAIN_FIELDS.values():
        assert not entry.metadata["symbol"] or f"[{entry.metadata['symbol']}]" in text
    for family in families():
        assert re.search(rf"^  (values.npy.*)?{family.family}\b", text, re.MULTILINE)
    for status in (0, 2, 3, 130):
        assert re.search(rf"^  {status}  ", text, re.MULTILINE)


@pytest.mark.parametrize("command", commands.COMMANDS)
def test_help_shows_the_main_options(command, capsys):
    text, complete = (help_text(f"{command} --{name}", capsys) for name in ("help", "help-all"))
    names = option_names(text)
    count = len([name for name in names if not name.startswith("help")])
    assert count <= 14
    assert count >= 2 or command == "explain"
    assert set(names) <= set(option_names(complete))
    last_line = text.splitlines()[-1]
    assert last_line.startswith(f"abfm {command} --help-all ") == (text != complete)
    main_options = getattr(commands.load(command), "MAIN_OPTIONS", ())
    arguments = {"mesh", "a", "b", "frames", "table"}
    assert set(main_options) - set(option_names(complete)) <= arguments


@pytest.mark.parametrize(
    ("command", "required"),
    [("population", "--template SURFACE --out DIR"), ("apply", "--out FILE")],
)
def test_usage_shows_required_options(command, required, capsys):
    assert f" {required} [options]" in help_text(f"{command} --help", capsys).splitlines()[0]


def test_commands_are_listed_and_parsers_keep_settings(abfm, capsys):
    assert len(re.findall(r"^  abfm ", abfm("").out, re.M)) == 3  # examples
    with pytest.raises(SystemExit):
        commands.run(["--help"])
    out = capsys.readouterr().out
    for command in commands.COMMANDS:
        assert f"\n  {command} " in out
    parsers = Parser(prog="abfm", description="").add_subparsers()
    # Python 3.14 colors help
    assert parsers.add_parser("match", description="", epilog="the end").epilog == "the end"


BENCH = "bench --success --problems=1"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("mtach", ["match"]),
        ("info", ["MESH"]),
        ("info {eight} --jsno", ["--json"]),
        ("info missing.off", ["missing.off"]),
        ("info none.npz", ["none.npz"]),
        (f"match {{eight}} {PAIR}", ["--out"]),
        ("match {eight} --out m.npz", ["source", "target"]),
        (f"{MATCH} --out m.txt", [".npz", ".ply", ".vtu", ".csv"]),
        (f"{MATCH} --out none/m.html", ["none"]),
        (f"{MATCH} --out m.npz --tau -1", ["tau", "-1.0", 0]),
        (f"{MATCH} --out m.npz --sigma soon", ["--sigma", "soon"]),
        (f"{MATCH} --out m.npz --path p.txt", [".csv"]),
        (f"{MATCH} --out m.csv --path m.csv", []),
        (f"{MATCH} --out m.npz --set levles=1", ["levels"]),
        (f"{MATCH} --out m.npz --set alpha=1", ["--alpha"]),
        (f"{MATCH} --out m.npz --set levels", ["levels"]),
        (f"{MATCH} --out m.npz --levels 2", ["--set levels="]),
        (f"{MATCH} --out m.npz --sgima 1", ["--sigma"]),
        ("bench --seconds 0", [0]),
        (f"{BENCH} --meshes {{eight}}", ["eight.off"]),
        (f"{BENCH} --only-given --meshes {{eight}} {{eight}}", ["eight.off"]),
        (f"{BENCH} --only-given", ["--meshes"]),
        (f"{BENCH} --meshes {{eight}} a-mesh.off", ["mesh.off"]),
        (f"{BENCH} --jobs=1 --scheduler=tcp://127.0.0.1:1", ["--scheduler"]),
        (f"{BENCH} --seconds=1", ["--seconds"]),
        (f"{BENCH} --arrival", ["--arrival"]),
        ("bench --measured --problems=1 --solvable", ["--success"]),
        ("bench --seconds=0.1 --only-given", ["--only-given"]),
        ("render none.npz --out a.png", ["none.npz"]),
        ("render none.npz --out a.jpg", [".png", ".mp4", ".gif"]),
        ("render none.npz --out a.png --size 10x10", ["320x240"]),
    ],
)
def test_bad_input_is_refused(line, named, abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    output = abfm(line, status=2)
    assert output.out == ""
    check_message(output.err, *named)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("m.ply", f"m.ply {PAIR} --out m.ply"),
        ("f.csv", "{eight} --source=file:f.csv+geodesic:vertex=0 --target=file:g --out=f.csv"),
        ("f.csv", f"{{eight}} {PAIR} --channel coordinate:x file:f.csv 1 --out=a.npz --path=f.csv"),
        ("f.csv", f"{{eight}} {PAIR} --mask f.csv --out f.csv"),
    ],
)
def test_input_files_are_not_overwritten(name, line, tmp_path, abfm, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("theirs")
    check_message(abfm(f"match {line}", status=2).err, name)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["theirs"]


def test_refused_meshes_have_a_remedy_and_json(tmp_path, abfm):
    spheres = [trimesh.creation.icosphere(2, radius=radius) for radius in (1.0, 0.3)]
    spheres[1].apply_translation([3, 0, 0])
    trimesh.util.concatenate(spheres).export(tmp_path / "two.off")
    assert "--largest-component" in abfm("info {t}/two.off", status=2).err
    facts = json.loads(abfm("info {t}/two.off --largest-component --json").out)
    assert facts["vertices"] == 162
    assert facts["messages"]
    (tmp_path / "fan.off").write_text(
        "OFF\n5 3 0\n0 0 0\n0 0 1\n1 0 0\n-1 1 0\n-1 -1 0\n3 0 1 2\n3 0 1 3\n3 0 1 4\n"
    )
    output = abfm("info {t}/fan.off --json", status=2)
    facts = json.loads(output.out)
    assert facts["usable"] is False
    assert output.err == f"abfm: {facts['objection']}\n"


def test_meshes_are_merged_and_cleaned(tmp_path, abfm):
    """Values for all vertices of the file fit, and output files have the length of the file."""
    sphere = icosphere(1)
    corners = np.concatenate([sphere.faces, sphere.faces[:1]]).ravel()
    path = tmp_path / "split.off"
    path.write_text(off_text(sphere.vertices[corners], np.arange(len(corners)).reshape(-1, 3)))
    of_corners = sphere.vertices[corners, 0]
    of_corners[-1] += 1  # the second value is that of a repeated vertex
    np.save(tmp_path / "x.npy", of_corners)
    for line in ("info --merge {t}/split.off --clean", "info {t}/split.off --clean --merge=1e-9"):
        assert json.loads(abfm(f"{line} --json").out)["vertices"] == 42
    for words, named in (("", "--merge"), ("--merge=near", "near"), ("--hemisphere left", "left")):
        assert named in abfm(f"info {{t}}/split.off {words}", status=2).err
    functions = "--source=file:{t}/x.npy --target=file:{t}/x.npy --merge --clean"
    output = abfm(f"match {{t}}/split.off {functions} {SHORT_RUN} --out {{t}}/m.npz")
    assert "warning: 1 of 201 merged" in output.err
    mesh = load(tmp_path / "m.npz").mesh
    assert mesh.on_file(mesh.vertices[:, 0]) == pytest.approx(sphere.vertices[corners, 0])
    abfm("map {t}/m.npz --out {t}/map.txt")
    assert (mesh.local_vertices(np.loadtxt(tmp_path / "map.txt")) == mesh.numbered[1]).all()


def test_match_writes_files_and_json(tmp_path, abfm):
    outs = [tmp_path / f"m.{suffix}" for suffix in ("npz", "ply", "vtu", "csv", "html")]
    line = f"match {{eight}} {PAIR} --set=iterations=20 --refine=0 --beta=0 --json"
    line += " --set=method=linearised --set=segments=2 --path {t}/p.csv --max-distortion=1000"
    output = abfm(line, *(f"--out={path}" for path in outs), status=UNREACHED)
    report, match = json.loads(output.out), load(outs[0])
    assert report["mesh"] == str(MESHES["eight"])
    assert report["outputs"] == [*map(str, outs), f"{tmp_path}/p.csv"]
    assert report["iterations"] == len(match.energy_history) - 1 <= 20
    for name in ("residual", "mismatch", "stop_reason", "verified_residual", "folded"):
        assert report[name] == getattr(match, name)
    assert report["energy"]["total"] == match.energy_history[-1, 0]
    assert report["parameters"] == match.parameters.to_dict()
    assert report["verdict"] == json.loads(json.dumps(asdict(match.verdict)))
    assert report["max_distortion"] == 1000
    attributes = trimesh.load(outs[1], process=False).metadata["_ply_raw"]
    assert attributes["vertex"]["data"]["advected"].ravel() == pytest.approx(match.advected[:, 0])
    field = attributes["face"]["data"]["velocity_segment_1_2"]
    assert field.ravel() == pytest.approx(match.velocity[1, :, 2])
    for name in ("source", "target", "advected", "velocity_segment_0", "velocity_segment_1"):
        assert f'Name="{name}"'.encode() in outs[2].read_bytes()
    rows = outs[3].read_text().splitlines()
    assert rows[0] == "iteration,stage,total,regularity,mismatch"
    assert len(rows) == len(match.energy_history) + 1
    assert len((tmp_path / "p.csv").read_text().splitlines()) == len(match.path) + 1
    page = outs[4].read_text(encoding="utf-8")
    abfm("render {t}/m.npz --out {t}/m.html")
    assert outs[4].read_text(encoding="utf-8") == page


def test_match_prints_the_outcome_and_advice(tmp_path, abfm):
    output = abfm(f"{MATCH} --out {{t}}/m.npz", status=UNREACHED)
    match = load(tmp_path / "m.npz")
    headline, reason, advice, wrote = output.out.splitlines()
    assert (headline, reason) == (match.facts.headline, match.facts.reason)
    assert wrote.startswith(f"wrote {tmp_path}/m.npz in ")
    assert MatchTask.report.advice(match, f"{tmp_path}/m.npz") in advice
    assert advice.endswith(f"; help: abfm explain {slug(match.verdict.cause)}")
    out = abfm(f"{MATCH} --out {{t}}/m.npz --source expression:1", status=UNREACHED).out
    headline, reason, advice, wrote = out.splitlines()
    assert headline.startswith("impossible")
    check_message(reason)
    check_message(advice)
    explain = "help: abfm explain source-constant"
    assert advice.endswith(explain)
    assert abfm(explain.removeprefix("help: abfm ")).out.startswith("Source constant\n\n")
    lines = abfm("info {t}/m.npz").out.splitlines()
    assert lines[-1] == explain
    match = load(tmp_path / "m.npz")
    check_names(lines[2], share(match.residual), share(match.verified_residual))


def test_explain_lists_all_sections_and_refuses_others(abfm):
    lines = abfm("explain").out.splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  ")] == [
        slug(name) for name in section_names()
    ]
    two = abfm("explain nearly Areas_change").out
    assert re.findall(r"^[A-Z][a-z ]+$", two, re.MULTILINE) == ["Nearly", "Areas change"]
    assert abfm("explain not reached").out == abfm("explain not-reached").out
    check_names(abfm("explain outlyer", status=2).err, "outlyer", "outlier")
    check_names(abfm("explain {eight}", status=2).err, "abfm info", MESHES["eight"])


def test_advice_improves_the_match(tmp_path, abfm):
    """A source that the flow squeezes away causes one warning during the match."""
    trimesh.Trimesh(EGG.vertices, EGG.faces, process=False).export(tmp_path / "egg.off")
    line = (
        "match {t}/egg.off --source=gaussian:x=0,y=0,z=1,width=0.1 --set=reach=0 --refine=1 "
        "--target=gaussian:x=0.5,y=0,z=-0.87,width=0.1 --set=iterations=40 --quiet --out={t}/m.npz"
    )
    output = abfm(line, status=UNREACHED)
    assert "\nthe flow squeezed the source to nothing" in output.out
    warning = r"warning: iteration \d+: the source is being squeezed to nothing .*\n"
    assert re.fullmatch(warning, output.err)
    options = shlex.split(re.search(r"^advice: reach further \((.*?)\)", output.out, re.M)[1])
    before = load(tmp_path / "m.npz").residual
    abfm(line, *options)
    assert load(tmp_path / "m.npz").residual < 0.2 * before


@pytest.mark.parametrize("quiet", ["", "--quiet"])
def test_long_steps_are_reported(quiet, abfm, monkeypatch):
    monkeypatch.setattr("abfm_viewer.cli.progress.SILENT_SECONDS", 0.0)
    slow = ("reading", "searching for symmetries", "checking by flow lines")
    monkeypatch.setattr(progress, "_rates", dict.fromkeys(slow, (1.0, 0)))
    lines = abfm(f"info {{eight}} {quiet}").err.splitlines()
    wanted = [] if quiet else ["reading an OFF mesh", slow[1]]
    assert lines == wanted
    pair = "--source=gaussian:vertex=0 --target=gaussian:vertex=300"
    line = f"match {{eight}} {pair} --set=iterations=5 --refine=0 --set=levels=1 --out {{t}}/m.npz"
    output = abfm(f"{line} {quiet}", status=UNREACHED).err
    lines = [] if quiet else ["match: mesh of 315 vertices, attempt 1 of 2", "check"]
    assert output.splitlines() == lines
    assert "factoring a system" not in output  # a step of unknown, short duration


def test_unknown_numbers_are_null(result):
    match = replace(load(result), verified_residual=float("nan"), folded=float("nan"))
    details = MatchTask.report.details(match)
    assert details["verified_residual"] is details["folded"] is None
    assert "flow lines" not in MatchTask.report.lines(match)[0]


def test_match_takes_a_mask_and_a_start(tmp_path, abfm, result):
    np.save(tmp_path / "a,1.npy", np.linspace(0, 1, 315))
    stage = "--set=cooling_stages=1 --set=reach=0 --set=levels=1"
    first = f"{MATCH} {stage} --out {{t}}/1.npz"
    abfm(first, "--mask", f"{tmp_path}/a,1.npy", status=UNREACHED)
    start = "--start {t}/1.npz --set=iterations=1 --out {t}/2.npz"
    abfm(f"{MATCH} {stage} {start}", "--mask", f"{tmp_path}/a,1.npy", status=UNREACHED)
    one, two = (load(tmp_path / f"{number}.npz") for number in (1, 2))
    assert one.mask == pytest.approx(np.linspace(0, 1, 315))
    assert two.energy_history[0] == pytest.approx(one.energy_history[-1])
    other = f"match {{human_A}} {PAIR} --start {{result}} --out {{t}}/m.npz"
    check_message(abfm(other, result=result, status=2).err)


def test_info_has_counts_and_symmetries_of_a_mesh(abfm):
    text = abfm("info {eight}").out
    for word in ("315", "634", "951", "genus         2", "none (closed)", "no defects"):
        assert word in text
    facts = json.loads(abfm("info {eight} --json").out)
    assert (facts["vertices"], facts["faces"], facts["edges"], facts["genus"]) == (315, 634, 951, 2)
    assert (facts["usable"], facts["boundary_loops"]) == (True, 0)
    lengths = facts["edge_lengths"]
    assert facts["edge_ratio"] == pytest.approx(lengths["longest"] / lengths["shortest"])
    text = abfm("info {human_A}").out
    check_message(line_with(text, "mirror"), "1 0 0")
    check_message(line_with(text, "rotation"))
    symmetries = json.loads(abfm("info {human_A} --json").out)["symmetries"]
    assert symmetries["rotation"] is None
    assert symmetries["mirror"]["is_permutation"] is True
    assert symmetries["mirror"]["error"] < 1e-9
    assert symmetries["mirror"]["axis"] == pytest.approx([1, 0, 0])


def test_printed_names_are_printable(tmp_path, capsys):
    folder = tmp_path / "a\nb\x1b[31m"
    folder.mkdir()
    mesh, result, table, picture = (str(folder / f"c\n.{s}") for s in ("off", "npz", "txt", "png"))
    shutil.copy(MESHES["eight"], mesh)
    render = ["render", result, "--out", picture, "--size", "320x240"]
    for words, status, printed in (
        (["info", mesh], 0, "/a?b?[31m/c?.off"),
        (["match", mesh, *f"{PAIR} {SHORT_RUN} --out".split(), result], UNREACHED, "c?.npz"),
        (["map", result, "--out", table], 0, "wrote {}/a?b?[31m/c?.txt"),
        (render, 0, "wrote {}/a?b?[31m/c?.png (320 x 240)"),
    ):
        assert main(words) == status
        lines = capsys.readouterr().out.splitlines()
        assert all(line.isprintable() for line in lines)
        assert printed.format(tmp_path) in "".join(lines)


def test_render_draws_pictures(result, tmp_path, abfm, project):
    line = "render {result} --out={t}/a.png --size=800x400 --time=0.5 --up=z --channel"
    assert abfm(f"{line} 1", result=result).out == f"wrote {tmp_path}/a.png (800 x 400)\n"
    assert pixels(tmp_path / "a.png").shape[:2] == (400, 800)
    check_message(abfm(f"{line} 2", result=result, status=2).err, 0, 1)
    line = "render {project} --out {t}/a.png --size 400x300"
    abfm(f"{line} --background transparent --dpi 150", project=project)
    shown = pixels(tmp_path / "a.png")
    assert shown.shape == (300, 400, 4)
    assert (shown[..., 3].min(), shown[..., 3].max()) == (0, 255)
    more = "--no-color-bar --no-labels --channel 1 --up=z --time=0"
    abfm(f"{line} {more}", project=project)
    assert pixels(tmp_path / "a.png").shape == (300, 400, 3)
    for style in ("sheet", "window"):
        for number, path in enumerate((result, project)):
            line = f"render {{path}} --style {style} --size 640x400 --out {{t}}/{style}{number}.png"
            abfm(line, path=path)
        one, other = (pixels(tmp_path / f"{style}{number}.png") for number in range(2))
        assert (one == other).all()


@pytest.mark.usefixtures("coarse_streaks")
@pytest.mark.parametrize(
    ("suffix", "options"),
    [
        ("mp4", "--to=2 --turntable=-90"),
        ("gif", "--from=1 --to=1 --streaks --progress"),  # only the streaks differ
    ],
)
def test_render_writes_movies(suffix, options, result, project, tmp_path, abfm):
    path, common = (project if suffix == "mp4" else result), "--size=330x240 --seconds=0.5 --fps=8"
    output = abfm(f"render {{path}} --out {{t}}/a.{suffix} {common} {options}", path=path)
    *lines, last = output.out.splitlines()
    assert last == f"wrote {tmp_path}/a.{suffix} (330 x 240, 4 frames)"
    if "progress" in options:
        assert list(map(json.loads, lines)) == [{"frame": n, "count": 4} for n in range(1, 5)]
    else:
        assert output.err == "".join(f"frame {frame} of 4\n" for frame in range(1, 5))
    with av.open(f"{tmp_path}/a.{suffix}") as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert (len(frames), frames[0].shape) == (4, (240, 330, 3))
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 0.1


@pytest.mark.usefixtures("coarse_streaks")
def test_render_draws_streaks(result, tmp_path, abfm):
    for number, words in enumerate(("", "--streaks", "--streaks --fade")):
        style = f"--style=window --size=640x400 --out={{t}}/{number}.png"
        abfm(f"render {{result}} {style} {words}", result=result)
    plain, full, faded = (pixels(tmp_path / f"{number}.png") for number in range(3))
    assert 0.1 < np.abs(faded - plain).mean() < np.abs(full - plain).mean()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("a.png --time -0.5", ["--time", "-0.5", 0, 2]),
        ("a.png --time 0.5 --time 2.5", ["--time", "2.5", 0, 2]),
        ("a.png --time nan", ["--time", "nan"]),
        ("a.png --style window --time 0 --time 1", ["--time"]),
        ("a.png --background white", ["--background", "--style"]),
        ("a.png --streaks --style sheet", ["--streaks"]),
        ("a.png --fps 30", ["--fps"]),
        ("a.png --style window --size 9000x9000", [16, 8192]),
        ("a.mp4 --fade", ["--fade", "--streaks"]),
        ("a.mp4 --to 3", ["--to", 3, 0, 2]),
        ("a.mp4 --from -1", ["--from", -1]),
        ("a.mp4 --time 1", ["--time"]),
        ("a.mp4 --style sheet", ["--style", "sheet"]),
        ("a.mp4 --background transparent", ["--background"]),
        ("a.mp4 --seconds 0", ["--seconds"]),
        ("a.gif --fps 60", ["--fps", 60, ".gif", "0.1", 50]),
        ("a.html --time 0.5", ["--time"]),
        ("a.html --from 0", ["--from"]),
        ("a.html --no-labels", ["--no-labels"]),
    ],
)
def test_render_refuses_useless_options(words, named, result, tmp_path, abfm):
    line = f"render {{result}} --out {{t}}/{words}"
    check_message(abfm(line, result=result, status=2).err, *named)
    assert list(tmp_path.iterdir()) == []


def test_render_draws_an_unsolved_match_only_as_a_picture(project, tmp_path, abfm):
    document, known = load_project(project)
    save_project(tmp_path / "unsolved.abfm", replace(document, result=None), known)
    line = "render {t}/unsolved.abfm --out {t}/a"
    for words in (".png --style sheet", ".html"):
        check_message(abfm(f"{line}{words}", status=2).err)
    abfm(f"{line}.png --size 320x240")
    (tmp_path / "m.npz").write_bytes(b"PK\x03\x04 not a zip")
    abfm("render {t}/m.npz --out {t}/a.png", status=2)


def test_demo_tests_itself(tmp_path, abfm, monkeypatch):
    monkeypatch.setattr("abfm_viewer.cli.demo._FRAMES", 5)
    out = tmp_path / "made" / "here"
    report = json.loads(abfm("demo --out {t}/made/here --json --quiet").out)
    assert report["mismatch"] <= 0.05
    assert sorted(path.name for path in out.iterdir()) == ["demo.mp4", "demo.npz", "demo.png"]
    assert report["movie"] == str(out / "demo.mp4")
    assert pixels(out / "demo.png").shape[1] == DEFAULT_WIDTH
    with av.open(str(out / "demo.mp4")) as movie:
        assert len(list(movie.decode(video=0))) == 5
    poor = partial(Parameters.of, iterations=1, refine=0)
    monkeypatch.setattr("abfm_viewer.cli.demo.Parameters", poor)
    no_picture = Mock(side_effect=DrawingError("no OpenGL here"))
    monkeypatch.setattr("abfm_viewer.pictures.match_picture", no_picture)
    output = abfm("demo --out {t} --quiet", status=1).err
    check_message(line_with(output, "no OpenGL here"), "note")
    check_message(output.splitlines()[-1])


def test_bench_passes_its_options(abfm, monkeypatch, tmp_path):
    """The benchmarks are replaced by functions that report their settings."""
    for module in (solver, success, map_errors):
        monkeypatch.setattr(module, "report_text", lambda report: f"of {report['seed']}")
    monkeypatch.setattr(solver, "run", lambda log, given: log("a line") or {"seed": given.seconds})
    assert abfm("bench --seconds 0.1 --json") == ('{"seed": 0.1}\n', "a line\n")
    assert abfm("bench --quiet") == ("of 60.0\n", "")
    given = []

    def run(trials, *solvable):
        given.append((trials, *solvable))
        return {"seed": trials.seed}

    monkeypatch.setattr(success, "run", run)
    monkeypatch.setattr(map_errors, "run", run)
    options = "--only-given --problems=1 --jobs=1 --seed=7 --meshes {eight}"
    output = abfm(f"bench --success --solvable --out={{t}}/b {options} --quiet --json {{t}}/b.json")
    assert (output.out, (tmp_path / "b.json").read_text()) == ("of 7\n", '{"seed": 7}')
    assert abfm(f"bench --measured {options}").out == "of 7\n"
    (counted, is_solvable), (measured,) = given
    assert is_solvable
    assert (counted.folder, measured.folder) == (tmp_path / "b", None)
    for trials in (counted, measured):
        assert (list(trials.meshes), trials.count, trials.cluster.jobs) == (["eight.off"], 1, 1)


def test_info_of_a_project_names_its_parts(abfm, result, project):
    match = load(result)
    lines = abfm("info {p}", p=project).out.splitlines()
    rows = [line.split(None, 1) for line in lines[1:3]]
    assert rows[0] == ["document", "match"]
    assert f"{len(match.mesh.faces):,} faces" in rows[1][1]
    assert sum(line.startswith("  function ") for line in lines) == match.source.shape[1] == 2
    assert line_with("\n".join(lines), "  result").endswith(match.facts.headline)
    facts = json.loads(abfm("info {p} --json", p=project).out)
    assert facts["result"]["residual"] == match.residual
    assert len(facts["functions"]) == 2


def test_lines_of_progress_are_few():
    """A line begins with each phase, attempt and mesh; later ones follow at growing distances."""
    state = TaskProgress()
    began = state.overall.began

    def iterate(seconds, attempt, vertices=2500, name="match"):
        now = began + seconds
        state.overall.update(Step(name, began=began, after=0.0, expected=seconds + 100))
        state.iteration, state.iterating = iteration(vertices, attempt), name
        return state.line(now)

    state.overall.update(Step("match", began=began, after=0.0))
    assert (state.line(began + 1), iterate(0.9, 1)) == ("", "")
    lines = [iterate(second, 1 + (second > 100)) for second in range(1, 400)]
    lines += [iterate(400, 2, 10_000, "refine")]
    assert list(filter(None, lines)) == [
        "match: mesh of 2,500 vertices, attempt 1 of 2",
        "match: 24%, 31 s so far, within about 2 min",
        "match: 48%, 2 min so far, within about 2 min",
        "match: mesh of 2,500 vertices, attempt 2 of 2",
        "match: 58%, 2 min so far, within about 2 min",
        "match: 67%, 3 min so far, within about 2 min",
        "match: 76%, 5 min so far, within about 2 min",
        "refine: mesh of 10,000 vertices",
    ]


def iteration(vertices, attempt):
    level = int(vertices > 2500)
    return Mock(vertices=vertices, level=level, attempt=attempt, attempts=2)

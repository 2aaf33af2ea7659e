"""`abfm population`, run in this process on a small sphere, with one process that registers."""

import csv
import json
import math
from pathlib import Path

import nibabel
import numpy as np
import pytest

import abfm as library
from abfm import Flow
from abfm.io import write_surface
from abfm_viewer import pictures
from abfm_viewer.cli import main
from abfm_viewer.cli.populations import population
from abfm_viewer.errors import DrawingError
from abfm_viewer.reports.pages import population_page
from tests.messages import check_message, line_with
from tests.shapes import icosphere
from tests.viewer.cli.test_report import Page

MESH = icosphere(2)
NAME = "<b>odd</b>"
COMMAND = ["population", "table.csv", "--template", "template.gii", "--out", "out"]
BRIEF = ["--refine=0", "--set=iterations=20", "--jobs=1", "--quiet", "--rounds=1"]


def height(places):
    x, y, z = places.T
    return x + y * z + x * z + 0.7 * (z * z - x * x) * y


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a table of five subjects and an odd one."""
    place = tmp_path_factory.mktemp("population")
    write_surface(place / "template.gii", MESH)
    middles = MESH.vertices[MESH.faces].mean(axis=1)
    field = np.cross(middles, [0.1, 0.2, 0.15])
    lines = ["name,depth,held-out:a label,weight"]
    for number, size in enumerate((-1, -0.5, 0, 0.5, 1)):
        there = Flow(MESH, size * field).point_map()
        np.save(place / f"{number}.npy", there.pull_back(height(MESH.vertices)))
        np.savetxt(place / f"{number}.csv", there.pull_back(np.sign(MESH.vertices[:, 2] - 0.2)))
        lines.append(f"subject {number},{number}.npy,{number}.csv,")
    np.save(place / "odd.npy", np.random.default_rng(2).normal(size=len(MESH.vertices)))
    lines.append(f"{NAME},odd.npy,,2")
    (place / "table.csv").write_text("\n".join(lines))
    return place


@pytest.fixture(scope="module")
def told(folder):
    """The words that were printed, and the status."""
    words = ["population", folder / "table.csv", "--template", folder / "template.gii"]
    with pytest.MonkeyPatch.context() as patch:
        said = []
        patch.setattr("builtins.print", lambda text, **where: said.append(text))
        patch.setattr(population, "_PICTURE_WIDTH", 48)
        more = ["--out", folder / "out", "--json", *BRIEF]
        status = main([*map(str, words), *map(str, more)])
    return json.loads(said[-1]), status


@pytest.fixture(scope="module")
def found(folder, told):
    return library.load(folder / "out" / "population.npz")


@pytest.fixture(scope="module")
def page(folder, told):
    return Page((folder / "out" / "population.html").read_text(encoding="utf-8"))


def test_the_status_says_whether_the_mean_has_come_to_rest(told):
    facts, status = told
    assert facts["changes"][0] > facts["bound"]
    assert status == 3


def test_facts_are_those_of_the_population(told, found):
    facts, _ = told
    worst = facts["subjects"][0]
    assert (worst["name"], worst["fits"], worst["weight"]) == (NAME, False, 2)
    check_message(worst["reason"])
    for each in facts["subjects"]:
        i = found.subject(each["name"])
        assert each["fits"] == found.fits[i]
        assert each["correlation"] == found.correlation[i]
        assert each["scores"]["depth"] == found.scores("depth")[i].tolist()
    depth, label = facts["channels"]
    assert depth["total"] == pytest.approx(depth["phase"] + depth["amplitude"])
    assert label["held_out"]
    assert label["after"] == pytest.approx(found.scores(1)[:5, 1].mean())
    assert worst["scores"]["a label"] == [None, None]


def test_a_table_has_a_line_a_subject_the_worst_first(folder, found):
    with (folder / "out" / "subjects.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [found.names[i] for i in found.worst_first()]
    for row in rows:
        i = found.subject(row["name"])
        assert float(row["log2_area"]) == found.log2_area[i]
        assert (folder / "out" / f"{row['digest']}.npz").is_file()
    assert rows[0]["a label after"] == ""
    assert float(rows[1]["a label after"]) == found.scores(1)[found.subject(rows[1]["name"]), 1]


def test_means_are_written_for_other_programs(folder, found):
    image = nibabel.load(folder / "out" / "mean.shape.gii")
    names = [array.meta["Name"] for array in image.darrays]
    kinds = ("mean", "deviation", "plain_mean")
    assert names == [f"{kind}_{name}" for name in ("depth", "a_label") for kind in kinds]
    assert image.darrays[0].data == pytest.approx(found.mean(), rel=1e-6)
    assert image.darrays[4].data == pytest.approx(found.deviation("a label"), rel=1e-6)
    content = (folder / "out" / "mean.vtu").read_bytes()
    for name in (*names, "log2_area_mean", "log2_area_deviation"):
        assert f'Name="{name}"'.encode() in content
    assert found.mean().astype("<f8").tobytes() in content


def test_the_page_tells_all_and_shows_names_as_they_are(page, found):
    assert all(link.startswith("data:") for link in page.links)
    assert NAME in page.text
    assert page.tags.count("b") == 1  # around "Advice:", and not in the name
    assert page.text.index(NAME) < page.text.index("subject 4")
    assert json.loads(page.facts)["subjects"][0]["name"] == NAME
    for text in (found.facts.headline, found.facts.reason[1:], "more rounds"):
        assert text in page.text


def test_the_page_tells_small_variances(page, told, found):
    small = {**told[0]["channels"][0], "total": 4e-6, "phase": 3e-6, "amplitude": 1e-6}
    text = Page(population_page({**told[0], "channels": [small]}, found.facts, None)).text
    for number in ("4e-06", "3e-06 (75%)", "1e-06 (25%)"):
        assert number in text
    assert f"{told[0]['channels'][0]['total']:.3g}" in page.text


def test_pictures_show_means_deviations_areas_and_the_odd_one(page):
    titles = [
        f"{name}, {column}"
        for name in ("depth", "a label")
        for column in ("mean, at first", "mean, registered", "deviation")
    ]
    titles += [f"areas, {each}" for each in ("mean of log2 J", "deviation of log2 J")]
    titles += [f"{NAME}, {each}" for each in ("at first", "registered", "mean of the others")]
    for title in titles:
        for side in ("front", "back"):
            picture = page.pictures[f"{title}, {side}"]
            assert picture.shape[1] == 48
            assert picture.std() > 5
    other = page.pictures[f"{NAME}, mean of the others, front"]
    own = page.pictures[f"{NAME}, registered, front"]
    assert np.abs(own - other).mean() > 10


def test_weights_and_landmarks_are_told(abfm, folder, monkeypatch):
    """Of two channels and two subjects, of which one has landmarks, in a folder beside its file."""
    (folder / "marks").mkdir(exist_ok=True)
    (folder / "marks" / "one.csv").write_text("\n".join(f"{k},{k}" for k in (0, 40, 90)))
    lines = ["name;depth;edge;landmarks"]
    lines += [f"s{k};{k}.npy;{k}.csv;{'marks/one.csv' if k == 1 else ''}" for k in (1, 2)]
    (folder / "two.csv").write_text("\r\n".join(lines), encoding="utf-8-sig")
    monkeypatch.chdir(folder.parent)
    words = [
        "population",
        folder / "two.csv",
        f"--template={folder}/template.gii",
        "--no-pictures",
        "--json",
    ]
    said = abfm(*words, "--weight", "edge=0.25", "--out", folder / "two", *BRIEF, status=3)
    facts = json.loads(said.out)
    assert [each["weight"] for each in facts["channels"]] == [1, 0.25]
    left = {each["name"]: each["landmarks"] for each in facts["subjects"]}
    assert left["s2"] is None
    assert left["s1"] < 0.02
    found = library.load(folder / "two" / "population.npz")
    assert found.landmarks[0] == left["s1"]
    page = Page((folder / "two" / "population.html").read_text(encoding="utf-8"))
    assert "edge, weight 0.25" in page.text
    assert f"{left['s1']:.3f}" in page.text


def test_running_again_solves_nothing_and_says_the_same(abfm, folder, found, monkeypatch):
    def refuse(*arguments):
        raise AssertionError("a row was solved again")

    monkeypatch.setattr("abfm.batch.ledger.Ledger.forget", refuse)
    before = (folder / "out" / "population.npz").read_bytes()
    words = [
        "population",
        folder / "table.csv",
        f"--template={folder}/template.gii",
        "--no-pictures",
    ]
    said = abfm(*words, "--out", folder / "out", *BRIEF, status=3)
    assert (folder / "out" / "population.npz").read_bytes() == before
    lines = said.out.splitlines()
    check_message(lines[0], 5, 6)
    check_message(line_with(said.out, "a label"), "held out")
    check_message(line_with(said.out, NAME), "left out")
    text = (folder / "out" / "population.html").read_text(encoding="utf-8")
    assert "<img" not in text


def test_registrations_of_the_last_round_are_a_batch(abfm, folder, found):
    said = json.loads(
        abfm("batch", "--status", folder / "out", "--no-pictures", "--json", status=3).out
    )
    assert said["counts"] == {
        "matched": 5,
        "not reached": 1,
    }  # the odd one is registered to nothing
    assert {row["digest"] for row in said["rows"]} == set(found.digests)
    assert {row["name"] for row in said["rows"]} == set(found.names)


def test_info_says_what_the_run_said(abfm, folder, told, found):
    path = folder / "out" / "population.npz"
    again = json.loads(abfm("info", path, "--json").out)
    assert again.pop("result") == str(path)
    own = {name: told[0][name] for name in ("table", "template", "bound", "seconds", "outputs")}
    assert {**again, **own} == told[0]
    lines = abfm("info", path).out.splitlines()
    count = int(found.fits.sum())
    check_message(lines[0], path, count, 6)
    check_message(lines[-1], NAME)
    assert library.load(folder / "out").names == found.names
    assert abfm("info", folder / "out").out.splitlines()[1:] == lines[1:]
    refused = abfm("render", path, "--out", folder / "p.png", status=2).err
    check_message(refused)


def test_a_page_without_a_screen_has_no_pictures(abfm, folder, found, monkeypatch):
    def refuse(*arguments):
        raise DrawingError("there is no screen")

    monkeypatch.setattr(pictures, "population_pictures", refuse)
    words = ["population", folder / "table.csv", "--template", folder / "template.gii"]
    said = abfm(*words, "--out", folder / "out", "--bound", "0.9", *BRIEF)  # which it keeps
    check_message(line_with(said.err, "note: "), "there is no screen")
    text = (folder / "out" / "population.html").read_text(encoding="utf-8")
    assert "more rounds" not in text


def test_a_subject_that_cannot_be_registered_is_told(abfm, folder, found):
    lines = (folder / "table.csv").read_text().splitlines()
    (folder / "more.csv").write_text("\n".join([*lines, "gone,file:gone.npy,,"]))
    words = [
        "population",
        folder / "more.csv",
        f"--template={folder}/template.gii",
        "--no-pictures",
    ]
    said = abfm(*words, "--out", folder / "out", *BRIEF, status=4)
    check_message(line_with(said.err, "note: "), "gone")
    check_message(line_with(said.out, "gone"), "left out")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["population", "table.csv", "--out", "out"], ("--template",)),
        (["population", "table.csv", "--template", "template.gii"], ("--out",)),
        (["population", "~no-user/s.csv", "--template=t.gii", "--out=out"], ("~no-user/s.csv",)),
        (
            ["population", "none.csv", "--template=template.gii", "--out=out"],
            ("none.csv",),
        ),
        (["population", "table.csv", "--template=none.gii", "--out=out"], ("none.gii",)),
        ([*COMMAND, "--function", "depth"], ("NAME=SPEC",)),
        (
            [*COMMAND, "--initial", "closset"],
            ("closset", "closest", "initial"),
        ),
        (
            [*COMMAND, "--function", "depht=coordinate:x"],
            ("depth",),
        ),
        ([*COMMAND, "--weight", "depth"], ("NAME=N",)),
        ([*COMMAND, "--weight", "depth=much"], ()),
        ([*COMMAND, "--weight", "depth=0"], (0,)),
        (
            [*COMMAND, "--weight", "depth=1", "--weight", "depth=2"],
            ("--weight", "depth"),
        ),
        ([*COMMAND, "--mask", "nonsense"], ("nonsense",)),
        ([*COMMAND, "--bound", "-1"], ("--bound",)),
        ([*COMMAND, "--alpha", "-1"], ("alpha", "-1.0")),
        (
            ["population", "table.csv", "--template=template.gii", "--out=table.csv"],
            (),
        ),
    ],
)
def test_what_does_not_fit_is_told_in_a_line(abfm, folder, monkeypatch, words, named):
    monkeypatch.chdir(folder)
    check_message(abfm(*words, "--quiet", status=2).err, *named)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder in which nobody may write")
def test_a_folder_that_takes_no_files_is_refused_before_subjects_are_read(
    abfm, folder, monkeypatch
):
    monkeypatch.chdir(folder)
    words = ["population", "table.csv", "--template=template.gii", "--out=/proc/self"]
    check_message(abfm(*words, status=2).err, "/proc/self/population.npz")


def test_the_table_of_subjects_is_not_replaced_by_what_is_found(abfm, tmp_path):
    (tmp_path / "subjects.csv").write_text("theirs")
    words = ["population", tmp_path / "subjects.csv", "--template=t.gii", f"--out={tmp_path}"]
    check_message(abfm(*words, status=2).err, "subjects.csv")
    assert (tmp_path / "subjects.csv").read_text() == "theirs"


def test_numbers_that_are_unknown_are_none(told):
    facts, _ = told

    def every(value):
        if isinstance(value, dict):
            for each in value.values():
                yield from every(each)
        elif isinstance(value, list):
            for each in value:
                yield from every(each)
        else:
            yield value

    assert all(math.isfinite(each) for each in every(facts) if isinstance(each, float))

import csv
import json
from pathlib import Path
from unittest.mock import Mock

import nibabel
import numpy as np
import pytest

import abfm as library
from abfm import Flow
from abfm.io import write_surface
from abfm_viewer import pictures
from abfm_viewer.cli import main, population
from abfm_viewer.errors import DrawingError
from abfm_viewer.reports.pages import population_page
from tests.messages import check_message, line_with
from tests.processes import words_of
from tests.shapes import icosphere
from tests.viewer.cli.page import Page, page_at

MESH = icosphere(2)
NAME = "<b>odd</b>"
BRIEF = "--refine=0 --set=iterations=20 --jobs=1 --quiet --rounds=1"
LINE = f"population {{f}}/table.csv --template {{f}}/template.gii --out {{f}}/out {BRIEF}"


def height(places):
    x, y, z = places.T
    return x + y * z + x * z + 0.7 * (z * z - x * x) * y


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a table of five subjects and an outlier."""
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
def facts(folder):
    with pytest.MonkeyPatch.context() as patch:
        output = []
        patch.setattr("builtins.print", lambda text, **where: output.append(text))
        patch.setattr(population, "_PICTURE_WIDTH", 48)
        assert main(words_of(f"{LINE} --json", f=folder)) == 3  # the mean has not converged
    return json.loads(output[-1])


@pytest.fixture(scope="module")
def found(folder, facts):
    return library.load(folder / "out" / "population.npz")


@pytest.fixture(scope="module")
def page(folder, facts):
    return page_at(folder / "out" / "population.html")


def test_json_has_the_facts_of_the_population(facts, found):
    worst = facts["subjects"][0]
    assert facts["changes"][0] > facts["bound"]
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
    json.dumps(facts, allow_nan=False)


def test_table_has_a_line_for_each_subject(folder, found):
    with (folder / "out" / "subjects.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [found.names[i] for i in found.worst_first()]
    for row in rows:
        assert float(row["log2_area"]) == found.log2_area[found.subject(row["name"])]
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


def test_page_has_all_and_escapes_names(page, facts, found):
    assert all(link.startswith("data:") for link in page.links)
    assert NAME in page.text
    assert page.tags.count("b") == 1  # the only bold text is "Advice:", not part of a name
    assert page.text.index(NAME) < page.text.index("subject 4")
    assert json.loads(page.facts)["subjects"][0]["name"] == NAME
    for text in (found.facts.headline, found.facts.reason[1:], "more rounds"):
        assert text in page.text
    small = {**facts["channels"][0], "total": 4e-6, "phase": 3e-6, "amplitude": 1e-6}
    text = Page(population_page({**facts, "channels": [small]}, found.facts, None)).text
    for number in ("4e-06", "3e-06 (75%)", "1e-06 (25%)"):
        assert number in text
    assert f"{facts['channels'][0]['total']:.3g}" in page.text


def test_pictures_show_means_areas_and_outliers(page):
    columns = ("mean, unregistered", "mean, registered", "standard deviation")
    titles = [f"{name}, {column}" for name in ("depth", "a label") for column in columns]
    titles += [f"areas, {each}" for each in ("mean of log2 J", "standard deviation of log2 J")]
    titles += [f"{NAME}, {each}" for each in ("unregistered", "registered", "mean of the others")]
    assert {*page.pictures} == {
        f"{title}, {side}" for title in titles for side in ("front", "back")
    }
    for picture in page.pictures.values():
        assert picture.shape[1] == 48
        assert picture.std() > 5
    other = page.pictures[f"{NAME}, mean of the others, front"]
    assert np.abs(page.pictures[f"{NAME}, registered, front"] - other).mean() > 10


def test_channels_have_weights_and_subjects_landmarks(abfm, folder, monkeypatch):
    (folder / "marks").mkdir(exist_ok=True)
    (folder / "marks" / "one.csv").write_text("\n".join(f"{k},{k}" for k in (0, 40, 90)))
    lines = ["name;depth;edge;landmarks"]
    lines += [f"s{k};{k}.npy;{k}.csv;{'marks/one.csv' if k == 1 else ''}" for k in (1, 2)]
    (folder / "two.csv").write_text("\r\n".join(lines), encoding="utf-8-sig")
    monkeypatch.chdir(folder.parent)
    line = LINE.replace("table.csv", "two.csv").replace("/out", "/two")
    output = abfm(f"{line} --no-pictures --json --channel edge auto 0.25", f=folder, status=3)
    facts = json.loads(output.out)
    assert [each["weight"] for each in facts["channels"]] == [1, 0.25]
    errors = {each["name"]: each["landmarks"] for each in facts["subjects"]}
    assert errors["s2"] is None
    assert errors["s1"] < 0.02
    assert library.load(folder / "two" / "population.npz").landmarks[0] == errors["s1"]
    page = page_at(folder / "two" / "population.html")
    assert "edge, weight 0.25" in page.text
    assert f"{errors['s1']:.3f}" in page.text


def test_running_again_solves_nothing(abfm, folder, found, monkeypatch):
    refuse = Mock(side_effect=AssertionError("a row was solved again"))
    monkeypatch.setattr("abfm.batch.ledger.Ledger.forget", refuse)
    before = (folder / "out" / "population.npz").read_bytes()
    output = abfm(f"{LINE} --no-pictures", f=folder, status=3)
    assert (folder / "out" / "population.npz").read_bytes() == before
    check_message(output.out.splitlines()[0], 5, 6)
    check_message(line_with(output.out, "a label"), "held out")
    check_message(line_with(output.out, NAME), "excluded")
    assert page_at(folder / "out" / "population.html").pictures == {}
    refuse = Mock(side_effect=DrawingError("there is no screen"))
    monkeypatch.setattr(pictures, "population_pictures", refuse)
    output = abfm(f"{LINE} --bound 0.9", f=folder)  # the mean satisfies this bound
    check_message(line_with(output.err, "note: "), "there is no screen")
    assert "more rounds" not in page_at(folder / "out" / "population.html").text


def test_registrations_of_the_last_round_are_a_batch(abfm, folder, found):
    output = json.loads(abfm("batch --status {f}/out --no-pictures --json", f=folder, status=3).out)
    assert output["counts"] == {"matched": 5, "not reached": 1}  # the registration of the outlier
    assert {row["digest"] for row in output["rows"]} == set(found.digests)
    assert {row["name"] for row in output["rows"]} == set(found.names)


def test_info_of_a_population_has_the_facts_of_its_run(abfm, folder, facts, found):
    path = folder / "out" / "population.npz"
    again = json.loads(abfm("info {p} --json", p=path).out)
    assert again.pop("result") == str(path)
    own = {name: facts[name] for name in ("table", "template", "bound", "seconds", "outputs")}
    assert {**again, **own} == facts
    lines = abfm("info {p}", p=path).out.splitlines()
    check_message(lines[0], path, int(found.fits.sum()), 6)
    check_message(lines[-2], NAME)
    assert lines[-1] == "help: abfm explain outlier"
    assert abfm("info {f}/out", f=folder).out.splitlines()[1:] == lines[1:]
    check_message(abfm("render {p} --out {t}/p.png", p=path, status=2).err)


def test_failed_subject_is_noted_and_excluded(abfm, folder):
    lines = (folder / "table.csv").read_text().splitlines()[:3]
    (folder / "few.csv").write_text("\n".join([*lines, "gone,file:gone.npy,,"]))
    line = LINE.replace("table", "few").replace("/out", "/few")
    output = abfm(f"{line} --no-pictures", f=folder, status=4)
    check_message(line_with(output.err, "note: "), "gone")
    check_message(line_with(output.out, "gone"), "excluded")


COMMAND = "table.csv --template template.gii --out out"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("table.csv --out out", ["--template"]),
        ("table.csv --template template.gii", ["--out"]),
        ("~no-user/s.csv --template=t.gii --out=out", ["~no-user/s.csv"]),
        ("none.csv --template=template.gii --out=out", ["none.csv"]),
        ("table.csv --template=none.gii --out=out", ["none.gii"]),
        (f"{COMMAND} --channel depth", []),
        (f"{COMMAND} --initial closset", ["closset", "closest", "initial"]),
        (f"{COMMAND} --channel depth auto x", ["--channel", "x"]),
        (f"{COMMAND} --channel depth auto 1 --channel depth auto 2", ["--channel", "depth"]),
        (f"{COMMAND} --bound -1", ["--bound"]),
        ("table.csv --template=template.gii --out=table.csv", []),
        ("subjects.csv --template=t.gii --out=.", ["subjects.csv"]),
    ],
)
def test_bad_input_is_refused(abfm, folder, monkeypatch, words, named):
    monkeypatch.chdir(folder)
    (folder / "subjects.csv").write_text("other")
    check_message(abfm(f"population {words} --quiet", status=2).err, *named)
    assert (folder / "subjects.csv").read_text() == "other"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no folder without write permission")
def test_unwritable_folder_is_refused_first(abfm, folder):
    line = LINE.replace("{f}/out", "/proc/self")
    check_message(abfm(line, f=folder, status=2).err, "/proc/self/population.npz")

"""Pages by `abfm match`, `abfm register` and `abfm render`: of what is found, and of files."""

import json
import re

import numpy as np
import pytest

from abfm.assets import asset_path
from tests.messages import check_message

EIGHT, *POSES = (str(asset_path(f"{name}.off")) for name in ("eight", "human_A", "human_B"))
PAIR = ["--source=gaussian:vertex=10,width=0.2", "--target=gaussian:vertex=40,width=0.2"]
SHORT = ["--set=iterations=4", "--refine", "0", "--quiet"]
UNMATCHED = 3  # the exit status of a run that is too short to arrive


def told(path):
    """What the script of a page is told."""
    text = path.read_text(encoding="utf-8")
    return json.loads(re.search(r'id="page">(.*?)</script>', text).group(1)), text


def test_a_match_is_written_as_a_page_beside_its_result(tmp_path, abfm):
    outs = [tmp_path / "m.npz", tmp_path / "m.html"]
    said = abfm("match", EIGHT, *PAIR, *SHORT, "--out", outs[0], "--out", outs[1], status=UNMATCHED)
    assert f"wrote {outs[0]}, {outs[1]}" in said.out
    page, text = told(outs[1])
    assert [panel["title"] for panel in page["panels"]] == ["source", "carried", "target"]
    assert said.out.splitlines()[0] in text.lower()  # the headline
    assert [page["clock"][name] for name in ("start", "end", "first")] == [0.0, 1.0, 1.0]
    again = tmp_path / "again.html"
    assert abfm("render", outs[0], "--out", again).out == f"wrote {again}\n"
    other, _ = told(again)
    assert other == page


def test_a_registration_is_written_as_a_page_of_both_surfaces(tmp_path, abfm):
    outs = [tmp_path / "r.npz", tmp_path / "r.html"]
    spec = "hks:time=0.01"
    words = ["register", POSES[0], POSES[1], "--source", spec, "--target", spec, *SHORT]
    abfm(*words, "--out", outs[0], "--out", outs[1])
    page, text = told(outs[1])
    assert [panel["title"] for panel in page["panels"]] == ["A", "A on B", "B"]
    assert [panel["mesh"] for panel in page["panels"]] == [0, 1, 1]
    assert "<dt>A covered</dt>" in text
    for axis in "yz":
        again = tmp_path / f"{axis}.html"
        abfm("render", outs[0], "--out", again, "--up", axis)
        up = np.reshape(told(again)[0]["panels"][1]["axes"], (3, 3))[1]
        assert np.argmax(up) == "xyz".index(axis)


def test_landmarks_alone_make_a_page_of_places(tmp_path, abfm):
    pairs, out = tmp_path / "pairs.csv", tmp_path / "marks.html"
    pairs.write_text("10,10\n400,400\n900,900\n")
    words = ["register", POSES[0], POSES[1], "--landmarks", pairs, *SHORT, "--out", out]
    abfm(*words)
    page, _ = told(out)
    assert [panel["title"] for panel in page["panels"]] == ["A", "A on B"]
    names = [layer["name"] for layer in page["panels"][1]["layers"]]
    assert names == ["x of A", "y of A", "z of A"]
    on_a, on_b = (panel["ways"] for panel in page["panels"])
    assert [way["name"] for way in on_a] == ["landmarks"]
    assert {"landmarks", "where landmarks belong"} <= {way["name"] for way in on_b}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--time", "0.5"], "--time is for pictures and movies, and"),
        (["--from", "0"], "--from is for pictures and movies, and"),
        (["--no-labels"], "--no-labels is for pictures and movies, and"),
    ],
)
def test_options_that_a_page_does_not_have_are_refused(words, expected, tmp_path, abfm):
    result = tmp_path / "m.npz"
    abfm("match", EIGHT, *PAIR, *SHORT, "--out", result, status=UNMATCHED)
    assert expected in abfm("render", result, "--out", tmp_path / "x.html", *words, status=2).err


def test_a_page_in_no_folder_is_refused_before_anything_is_matched(tmp_path, abfm):
    words = ["match", EIGHT, *PAIR, "--out", tmp_path / "none/m.html"]
    check_message(abfm(*words, status=2).err)

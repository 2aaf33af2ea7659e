"""Tables of subjects."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm import ParameterError
from abfm.functions import parse
from abfm.population import Channel, Cohort, Subject, read_subjects
from abfm.population.subjects import _cohort
from tests.messages import raises


def written(folder, text):
    path = folder / "table.csv"
    path.write_text(text)
    return path


def test_paths_are_relative_to_the_table(tmp_path):
    (tmp_path / "a, b.npy").touch()
    text = (
        "Name;surface;sulc;held-out:label;MASK;weight;Landmarks\n"
        "one;sub/one.off;a, b.npy;file:label.csv;known.txt + indicator:vertex=3;2;marks/one.csv\n"
        "\n"
        "two;;gaussian:vertex=3,width=0.1;;;;\n"
    )
    (tmp_path / "known.txt + indicator:vertex=3").touch()
    found = read_subjects(written(tmp_path, text))
    assert found.channels == (Channel("sulc"), Channel("label", is_held_out=True))
    assert found.registered_channels == [0]
    one, two = found.subjects
    assert one.surface == str(tmp_path / "sub/one.off")
    assert parse(one.functions[0]).path == str(tmp_path / "a, b.npy")
    assert str(tmp_path / "label.csv") in one.functions[1]
    assert str(tmp_path / "known.txt") in one.mask
    assert one.weight == 2
    assert one.landmarks == str(tmp_path / "marks/one.csv")
    assert two == Subject("two", ("gaussian:vertex=3,width=0.1", ""))


def test_unnamed_rows_are_numbered(tmp_path):
    found = read_subjects(written(tmp_path, "f\ncoordinate:y\ncoordinate:x\n"))
    assert [each.name for each in found.subjects] == ["row 1", "row 2"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ()),
        ("name,f\none,coordinate:x\n", (1,)),
        ("name,held-out:f\none,coordinate:x\ntwo,coordinate:x\n", ()),
        ("name,landmarks\none,a.csv\ntwo,b.csv\n", ()),
        ("name,f\none,coordinate:x\none,coordinate:x\n", ("one",)),
        ("name,f,f\none,coordinate:x,coordinate:x\n", ("f",)),
        ("f,held-out:f\ncoordinate:x,coordinate:x\ncoordinate:x,\n", ("f",)),
        ("name,,f\none,,coordinate:x\n", (2,)),
        ("name,held-out:\none,coordinate:x\n", ()),
        ("name,f\none,coordinate:x\ntwo,\n", ("two", "f")),
        ("name,f\none,coordinate:x\ntwo,no.npy\n", ("no.npy", 2, "f")),
        ("name,f,weight\none,coordinate:x,x\n", ("x", "weight")),
        ("name,f,weight\none,coordinate:x,-1\ntwo,coordinate:x,1\n", ("weight", -1)),
        ("name,f,weight\none,coordinate:x,nan\ntwo,coordinate:x,1\n", ("weight", "nan")),
        ("name,f,weight\none,coordinate:x,0\ntwo,coordinate:x,0\n", ("weight", 0)),
        ("name,f\none,coordinate:x,3,4\n", (1, 4, 2)),
        ('name,f\n"one,coordinate:x\n', (2,)),
        ("f,mask\ncoordinate:x,nonsense\ncoordinate:x,\n", (1, "mask")),
        ("name,f\no\u200bne,coordinate:x\ntwo,coordinate:x\n", ("subject",)),
    ],
)
def test_invalid_tables_are_refused(tmp_path, text, named):
    with raises(ParameterError, "table.csv", *named):
        read_subjects(written(tmp_path, text))


def test_missing_or_binary_table_is_refused(tmp_path):
    with raises(ParameterError):
        read_subjects(tmp_path / "none.csv")
    path = tmp_path / "latin.csv"
    path.write_bytes(b"name,f\n\xe9,coordinate:x\n")
    with raises(ParameterError, "UTF-8"):
        read_subjects(path)


def test_subject_needs_all_channels():
    channels = (Channel("f"), Channel("g"))
    with raises(ParameterError, 1, 2):
        Cohort(
            channels,
            (Subject("a", ("coordinate:x",)), Subject("b", ("coordinate:x", "coordinate:x"))),
        )


@given(st.text(alphabet='nameweightf,;\t\n" 0123456789.:-é', max_size=80))
def test_any_text_is_read_or_refused(text):
    refused = ""
    try:
        found = _cohort(text, "/nowhere")
    except ParameterError as error:
        refused = str(error)
    assert "\n" not in refused
    assert refused or len(found.subjects) >= 2

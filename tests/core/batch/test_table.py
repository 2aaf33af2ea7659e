import csv
import io
from contextlib import suppress

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from abfm.batch import combinations, read_table
from abfm.batch.table import rows_of_text
from abfm.errors import AbfmError, ParameterError
from tests.messages import check_message, raises

SPECS = ["curvature:mean", "gaussian:vertex=1,width=0.2", 'file:"a ""b"", c.npy"', "hks:time=0.1"]
NAMES = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=8)
NUMBERS = st.floats(1e-6, 1e6)
MORE = ("sigma", "refine", "largest-component")
OPTIONS = st.fixed_dictionaries(
    {
        "mesh": st.sampled_from(["m.off", "with, comma.obj", "straße.ply"]),
        "source": st.sampled_from(SPECS),
        "target": st.sampled_from(SPECS),
    },
    optional={
        "name": NAMES,
        "alpha": NUMBERS.map(repr),
        "sigma": st.one_of(st.just("auto"), NUMBERS.map(repr)),
        "mask": st.sampled_from(["mask.npy", "coordinate:x"]),
        "refine": st.integers(0, 3).map(str),
        "largest-component": st.sampled_from(["yes", "no"]),
    },
)


def written(columns, rows, delimiter=",", end="\r\n"):
    text = io.StringIO(newline="")
    writer = csv.writer(text, delimiter=delimiter, lineterminator=end)
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


@given(
    st.lists(OPTIONS, min_size=1, max_size=4),
    st.permutations(["name", "mesh", "source", "target", "alpha", "mask", *MORE]),
    st.sampled_from(",;\t"),
    st.sampled_from(["\n", "\r\n"]),
)
def test_written_tables_are_read(options, columns, delimiter, end):
    cells = [[each.get(column, "") for column in columns] for each in options]
    names = [each.get("name", f"row {number}") for number, each in enumerate(options, 1)]
    assume(len({*names}) == len(names))
    rows = rows_of_text(written(columns, cells, delimiter, end), "/somewhere")
    assert len(rows) == len(options)
    for number, (row, each) in enumerate(zip(rows, options, strict=True), 1):
        assert row.name == each.pop("name", f"row {number}")
        assert dict(row.options) == each
        assert row.folder == "/somewhere"
        assert row.files()[0].startswith("/somewhere/")


@given(st.text(max_size=60))
@example("mesh\nm.off")
@example('mesh,source\n"')
@example("mesh,source,target\nm.off,curvature:mean,curvature:mean,1")
@example("\0")
@example("name\n\n\n1,2")
def test_any_text_is_read_or_refused(text):
    with suppress(AbfmError):
        assert rows_of_text(text, "/")


def test_column_names_may_be_options_or_python_names(tmp_path):
    head = "\ufeffName,--mesh,Cooling_Stages,channel,channel,max-distortion"
    channels = "curvature:mean coordinate:x 1,coordinate:x curvature:mean .5"
    path = tmp_path / "t.csv"
    path.write_text(f"{head}\n\none,m.off,3,{channels},1.5\n,,,,,\n,m.off,,,{channels[:30]}\n")
    first, second = read_table(path)
    values = first.values()
    assert values["mesh"] == str(tmp_path / "m.off")
    assert values["cooling-stages"] == 3
    assert values["channel"] == [
        ("curvature:mean", "coordinate:x", 1.0),
        ("coordinate:x", "curvature:mean", 0.5),
    ]
    assert values["max-distortion"] == 1.5
    assert (first.name, second.name) == ("one", "row 2")
    assert len(second.values()["channel"]) == 1


def test_decimal_commas_are_numbers():
    text = 'mesh;alpha;sigma;channel\nm.off;0,03;"1,5e-3";coordinate:x coordinate:y 0,5\n'
    values = rows_of_text(text, "/")[0].values()
    assert (values["alpha"], values["sigma"]) == (0.03, 1.5e-3)
    assert values["channel"] == [("coordinate:x", "coordinate:y", 0.5)]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ()),
        ("mesh;alpha\nm.off;1,234\n", (1, "alpha", "decimal")),
        ("mesh,source,target\n", ()),
        ("mesh,sauce\nm.off,1\n", ("sauce", "source", 2)),
        ("mesh,mesh\nm.off,1\n", ("mesh", 2)),
        ("mesh,\nm.off,1\n", (1, 2)),
        ("mesh,alpha\nm.off,much\n", ("much", 1, "alpha")),
        (
            "mesh,source,target\nm.off,curvature:mean,curvature:mean\nm.off,x:1,curvature:mean",
            ("x", 2, "source"),
        ),
        ("mesh,source\nm.off,gaussian:vertex=1,width=2\n", ()),
        ("source,target\ncurvature:mean,curvature:mean\n", (1,)),
        ('mesh,source\nm.off,"x\n', (2,)),
        ("mesh,source,target\nm\0.off,coordinate:x,coordinate:y\n", (2, "UTF-8")),
        (
            "name,mesh,source,target\n" + 2 * "one,m.off,coordinate:x,coordinate:y\n",
            (1, 2, "'one'"),
        ),
    ],
)
def test_invalid_cells_are_refused_with_row_and_column(text, named, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(ParameterError) as error:
        read_table(path)
    assert str(error.value).startswith(f"table {path}: ")
    check_message(str(error.value), *named)


@pytest.mark.parametrize("content", [None, b"\xff\xfe\0mesh"])
def test_binary_or_missing_table_is_refused(content, tmp_path):
    path = tmp_path / "table.csv"
    if content is not None:
        path.write_bytes(content)
    with raises(ParameterError, "table.csv"):
        read_table(path)


def test_combinations_are_complete_and_ordered():
    fixed = {"mesh": "m.off", "source": "curvature:mean", "target": "coordinate:x", "tau": 2}
    over = {"alpha": [0.1, 0.2], "sigma": ["auto", 0.5, 1], "order": [1, 2]}
    rows = combinations(fixed.items(), over, "/x")
    assert len({row.key for row in rows}) == len(rows) == 12
    values = [row.values() for row in rows]
    assert {(v["alpha"], v["sigma"], v["order"]) for v in values} == {
        (alpha, sigma, order)
        for alpha in over["alpha"]
        for sigma in (None, 0.5, 1.0)
        for order in over["order"]
    }
    assert all(v["tau"] == 2 and v["mesh"] == "/x/m.off" for v in values)
    assert rows[1].name == "alpha 0.1, sigma auto, order 2"


def test_fixed_option_cannot_be_varied():
    fixed = {"mesh": "m.off", "source": "curvature:mean", "target": "coordinate:x", "alpha": 1}
    with raises(ParameterError, "alpha"):
        combinations(fixed.items(), {"alpha": [1]})
    with raises(ParameterError):
        combinations(fixed.items(), {"sigma": []})
    with raises(ParameterError):
        combinations(fixed.items(), {"sigma": range(2000), "beta": range(2000)})


def test_tilde_of_unknown_user_is_a_plain_name(tmp_path):
    (tmp_path / "t.csv").write_text(
        "mesh,source,target\n~no-user/m.off,file:~no-user/f.csv,file:g\n"
    )
    [row] = read_table(tmp_path / "t.csv")
    names = ("~no-user/m.off", "~no-user/f.csv", "g")
    assert {*row.files()} == {str(tmp_path / name) for name in names}

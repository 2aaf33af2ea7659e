"""Text tables: separators, decimal commas, and ambiguous files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from abfm.reading import read_numbers, rows_of
from abfm.reading.text_tables import parse_number
from tests.messages import raises

NUMBERS = np.array([[0.369, -12.5], [1e-3, 1000.25], [7, 0]])


def written(separator, decimal=",", quote=""):
    cells = [
        [f"{quote}{x!r}{quote}".replace(".", decimal) for x in row] for row in NUMBERS.tolist()
    ]
    return "\n".join(separator.join(row) for row in cells) + "\n"


@pytest.mark.parametrize("separator", [";", "\t", " ", "  ", "; "])
@pytest.mark.parametrize("head", ["", "depth{}area\n"])
def test_decimal_commas_need_other_separators(separator, head):
    names, found, _ = read_numbers(head.format(separator) + written(separator))
    assert_array_equal(found, NUMBERS)
    assert [name.strip() for name in names] == (["depth", "area"] if head else [])
    assert_array_equal(read_numbers(written(",", quote='"')).table, NUMBERS)


NAN = np.nan
AFNI = "# ---------\n# surface 'a' :\n#\n#  node   v0\n# -----  ----\n 3  0.5\n"
READ = {  # text, names and numbers
    "decimal commas in quotes": ('"0,369"\n"1,5"\n', [], [[0.369], [1.5]]),
    "separator line of Excel": ("sep=;\na;b\n1;2\n", ["a", "b"], [[1, 2]]),
    "one name": ("mean depth\n0,369\n-1,25\n", ["mean depth"], [[0.369], [-1.25]]),
    "names of two columns": ("a,b\n0,369\n1,25\n", ["a", "b"], [[0, 369], [1, 25]]),
    "commas with blanks": ("0, 369\n1, 25.5\n", [], [[0, 369], [1, 25.5]]),
    "first number missing": ("NA,1\n2,3\n", [], [[NAN, 1], [2, 3]]),
    "first line missing": ("NA\n2\n", [], [[NAN], [2]]),
    "first line with an error of Excel": ("#VALUE!\n2\n", [], [[NAN], [2]]),
    "first line false": ("FALSE\nTRUE\n", [], [[0], [1]]),
    "series of pandas": (",0\n5,1\n", ["", "0"], [[5, 1]]),
    "row names of R": (
        '"x" "y z"\n"1" 0.5 NA\n"2" 1 3\n',
        ["", "x", "y z"],
        [[1, 0.5, NAN], [2, 1, 3]],
    ),
    "title": ("depth of 2\n1 0.5 2 1\n3 1 3 1\n", [], [[1, 0.5, 2, 1], [3, 1, 3, 1]]),
    "exponents of Fortran": ("1.5D+01, 2d-1\n-1, 3\n", [], [[15, 0.2], [-1, 3]]),
    **{
        f"exponents of Fortran after {each!r}": (
            f"1,5D+01{each}2,5d-1\n-1{each}3,0D0\n",
            [],
            [[15, 0.25], [-1, 3]],
        )
        for each in ("; ", "\t", " ")
    },
    "column of words": ('a,area,b\n1,"V1, left",\n2.5,V2,4\n', ["a", "b"], [[1, NAN], [2.5, 4]]),
    "separator at the end": ("0.5,1,\n2,3,\n", [], [[0.5, 1], [2, 3]]),
    "separator at the end, names": ("a,b\n0.5,1,\n2,3,\n", ["a", "b"], [[0.5, 1], [2, 3]]),
    "booleans, Unicode minus": ("a,m\n1,True\n\u22122,FALSE\n", ["a", "m"], [[1, 1], [-2, 0]]),
    "line below names of AFNI": (AFNI.encode(), ["node", "v0"], [[3, 0.5]]),
    "encoding of Excel": ("Größe;n\r\n0,5;1\r\n".encode("cp1252"), ["Größe", "n"], [[0.5, 1]]),
}


@pytest.mark.parametrize(("text", "names", "numbers"), READ.values(), ids=READ)
def test_tables_of_programs_are_read(text, names, numbers):
    found = read_numbers(text)
    assert found.names == names
    assert_array_equal(found.table, numbers)


def test_integers_may_be_expected():
    """If integers are expected, a comma between them separates columns without names."""
    assert_array_equal(read_numbers("0,369\n1,25\n", integers=True).table, [[0, 369], [1, 25]])


def test_columns_of_words_are_omitted():
    assert read_numbers('a,area,b\n1,"V1, left",\n2.5,V2,4\n').places == [0, 2]
    with raises(ValueError, "V1", 0):
        read_numbers("a,b\n1,V1\n2,3\n")


def test_fortran_exponents_are_read():
    """Decimal commas are ambiguous also with exponents, such as -6,25D+02."""
    with raises(ValueError, "-6,25D+02", "decimal"):
        read_numbers("-6,25D+02\n2,5D+00\n")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("0,369\n1,25\n", ("'0,369'", "'0.369'", 2)),
        ("0,369, 1,25\n0,5, 0,75\n", (4,)),
        ("depth,area\n0,369,1,25\n", (2, 4)),
        ("0,369;1.5\n", ("'0,369'",)),
        ('"0,369",1.5\n', ("'0,369'",)),
        ("1,234\t5,678\n", ("'1,234'", "thousands")),
        ('"1,234","5,678"\n', ("'1,234'", "thousands")),
        ("a;b\n1,110,000;2\n", ("'1,110,000'", "thousands")),
        ("1\0\n", (1, "UTF-8")),
        ("# nothing\n", ()),
        ("a;b\n1,234.5;2\n", ("'1,234.5'", "thousands")),
    ],
)
def test_ambiguous_tables_are_refused(text, named):
    with raises(ValueError, *named):
        read_numbers(text)


@given(
    rows=st.lists(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2), min_size=1, max_size=5),
    separator=st.sampled_from([";", "\t", ",", " "]),
    mark=st.booleans(),
    encoding=st.sampled_from(["utf-8-sig", "utf-16", "utf-16-le"]),
)
def test_numbers_round_trip(rows, separator, mark, encoding):
    decimal = "," if mark and separator != "," else "."
    cells = [[f"{x:.4f}".replace(".", decimal) for x in row] for row in rows]
    text = "\r\n".join([f"one{separator}two", *(separator.join(row) for row in cells)])
    names, found, _ = read_numbers(text.encode(encoding))
    assert names == ["one", "two"]
    assert_array_equal(found, [[float(f"{x:.4f}") for x in row] for row in rows])


def test_decimal_commas_in_rows_are_numbers():
    table = rows_of('name;place\n"a;b";1,5\n\n', comments="#")
    assert [*table.cells] == [["name", "place"], ["a;b", "1,5"]]
    assert table.number("1,5") == table.number("1.5") == 1.5
    assert table.number("1,234") == 1.234
    assert [*rows_of("0,5 1,5 left").cells] == [["0", "5 1", "5 left"]]
    assert [*rows_of("0,5 1,5\n2,5 3").cells] == [["0,5", "1,5"], ["2,5", "3"]]
    with raises(ValueError, "1,234"):
        parse_number("1,234")
    assert parse_number("0,234") == 0.234


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("word", ["", '""', "NA", "n/a", "NULL", "#N/A", "#DIV/0!", "missing", "."])
def test_missing_numbers_are_nan(separator, word):
    lines = ["a,b", f"0.5,{word}", f"{word},2", "NaN,3"]
    names, found, _ = read_numbers("\n".join(line.replace(",", separator) for line in lines))
    assert names == ["a", "b"]
    assert_array_equal(found, [[0.5, np.nan], [np.nan, 2], [np.nan, 3]])

import csv

import pytest

from abfm.io import write_csv


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("=HYPERLINK(1)", "'=HYPERLINK(1)"),
        ("+cmd", "'+cmd"),
        ("-cmd|' /C calc'!A0", "'-cmd|' /C calc'!A0"),
        ("@SUM(1)", "'@SUM(1)"),
        ("\t=1", "'=1"),
        ("\r\n-x", "'-x"),
        ("\uff1d1", "'\uff1d1"),
        ("a\x1b[31mb", "a?[31mb"),
        ("\ud800", "?"),
        ("-0.5", "-0.5"),
        ("+1e-3", "+1e-3"),
        ("a = b", "a = b"),
        ('say "no", x', 'say "no", x'),
        (-0.5, "-0.5"),
        (None, ""),
        (True, "True"),
    ],
)
def test_cells_cannot_be_formulas(tmp_path, cell, expected):
    write_csv(tmp_path / "a.csv", [["first", cell]])
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["first", expected]]

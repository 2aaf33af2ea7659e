"""Readers of text tables: separators of cells, decimal commas, names and numbers."""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from abfm.errors import brief, one_line
from abfm.reading.opening import decoded
from abfm.reading.words import number
from abfm.types import FloatArray

_SEPARATORS = ";\t,"
_QUOTED_TEXT = re.compile(r'"[^"]*"')
_DECIMAL = re.compile(r"[+-]?\d+,\d+(?:[eEdD][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
_COMMA_AND_BLANK = re.compile(r",\s+")
_EXCEL_LINE = re.compile(r"\A\s*sep=.[ ]*\n", re.IGNORECASE)  # a line that declares the separator
_POINT = re.compile(r"\d\.|\.\d")
_WITH_COMMA = re.compile(r"[+-]?\d*(?:[.,]\d+)+(?:[eEdD][+-]?\d+)?")
_FORTRAN = re.compile(r"\A([+-]?[\d.]+)[dD]([+-]?\d+)\Z")
_WORD = re.compile(r'"[^"]*"|\S+')
_BINARY = re.compile(rb"[\0-\x08\x0e-\x1f]")
# errors in cells of Excel
_ERRORS = ("#N/A", "#NV", "#DIV/0!", "#VALUE!", "#REF!", "#NUM!", "#NAME?", "#NULL!")
_MISSING_WORDS = ("na", "n/a", "<na>", "nan", "null", "none", "missing", ".")
_MISSING_VALUES = (*_MISSING_WORDS, *map(str.lower, _ERRORS))
_TRUTH = {"true": "1", "false": "0"}
_NUMPY_ERROR = re.compile(  # NumPy counts rows from 0 and columns from 1
    r"could not convert string (?P<word>.*) to float64 at row (?P<row>\d+), column (?P<column>\d+)",
    re.DOTALL,
)
_OPEN_QUOTE = "a double quote is not closed"
_ADVICE = "write decimal points, or separate the columns by semicolons"


class Rows(NamedTuple):
    """Cells of each line of a table, and the separator of cells; None if blanks separate cells."""

    cells: Iterator[list[str]]
    separator: str | None

    def number(self, text: str) -> float:
        return parse_number(text, decimal_comma=self.separator in (";", "\t", None))


def rows_of(data: bytes | str, comments: str | None = None, blanks: bool = True) -> Rows:
    """Return the cells of all lines of a table that are not empty, without blanks around them.

    ``data`` is a file in UTF-8 or UTF-16, or its text. Lines that begin with ``comments`` are
    skipped. The first line determines the separator: semicolon, tab or comma. If it has none of
    these, the separator is blanks, or the comma if ``blanks`` is False. ValueError, also while
    iterating, if the text cannot be decoded or quotes are not closed.
    """
    text = _text(data)
    first = next((line for line in _lines(text, comments)), "")
    separator = _separator(first) or (None if blanks else ",")
    return Rows(_cells(text, separator, comments), separator)


def _cells(text: str, separator: str | None, comments: str | None) -> Iterator[list[str]]:
    if separator is None:
        yield from (line.split() for line in _lines(text, comments))
        return
    rows = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        for row in rows:
            cells = [cell.strip() for cell in row]
            if any(cells) and not (comments and row[0].startswith(comments)):
                yield cells
    except csv.Error as error:
        raise ValueError(f"line {rows.line_num}: {_table_error(error)}") from None


def _table_error(error: csv.Error) -> str:
    if "field limit" in str(error):
        return f"a cell has more than {csv.field_size_limit():,} characters"
    return one_line(error).replace("unexpected end of data", _OPEN_QUOTE)


def parse_number(text: str, decimal_comma: bool = False) -> float:
    """Return the number in a cell, which may have a decimal comma.

    Raises ValueError if the cell is not a number, or if its comma may separate thousands and
    ``decimal_comma`` is False.
    """
    if not decimal_comma and _THOUSANDS.fullmatch(text):
        raise ValueError(
            f"the comma of {brief(text)} may be decimal or separate thousands. Write a decimal "
            "point"
        )
    return number(text.replace(",", ".") if _DECIMAL.fullmatch(text) else text)


class Numbers(NamedTuple):
    """Columns of numbers of a text table."""

    names: list[str]  # names of the columns; empty if there are none
    table: FloatArray  # the numbers, (n, C)
    places: list[int]  # index of each column in the file, (C,); columns of words are omitted


def read_numbers(data: bytes | str, integers: bool = False) -> Numbers:
    """Read a table of numbers.

    Semicolons, tabs, commas or blanks separate cells. Commas inside cells are decimal. Blank cells
    and words such as NA become NaN; true and false become 1 and 0. Empty lines and lines that begin
    with ``#`` are skipped. If the first line is not all numbers, it has the names of the columns.
    Otherwise the last comment above the numbers has them, if its number of words is that of the
    columns. A named column of other words is omitted, and also a last column of blank cells.

    ``data`` is a file in UTF-8 or UTF-16, or its text. If ``integers`` is True, integers are
    expected, and a comma between two of them separates columns. Raises ValueError if cells are not
    numbers, or if commas are ambiguous.
    """
    text = _text(data)
    lines = list(_lines(text, "#"))
    if not lines:
        raise ValueError("the file has no numbers; expected a table of numbers")
    separator = _separator(lines[min(1, len(lines) - 1)])
    first = [name.strip() for name in _split(lines[0], separator)]
    words = (*_MISSING_VALUES, *_TRUTH)
    present = first if first[-1] else first[:-1]
    has_names = not all(is_number(cell) or cell.lower() in words for cell in present)
    names = first if has_names else []
    rows = lines[1:] if names else lines
    if not rows:
        raise ValueError(f"the file has no numbers, only the line {brief(lines[0])}")
    if "," in text:
        rows, separator = _with_points(rows, separator, names, integers)
    try:
        table = _loaded(rows, separator)
    except ValueError as error:
        return _with_gaps(rows, separator, names, error)
    names = names or _commented_names(text, separator)
    return _numbers(names, table, list(range(table.shape[1])))


def _loaded(rows: list[str], separator: str | None) -> FloatArray:
    return np.loadtxt(rows, delimiter=separator, comments=None, quotechar='"', ndmin=2)


def _numbers(names: list[str], table: FloatArray, places: list[int]) -> Numbers:
    count, width = table.shape
    if len(names) == width - 1 and np.array_equal(np.sort(table[:, 0]), np.arange(1, count + 1)):
        names = ["", *names]  # R writes no name for the column of row names
    fitting = len(names) == width  # other words in the first line are a title
    return Numbers(names if fitting else [], table, places)


def _with_gaps(
    rows: list[str], separator: str | None, names: list[str], error: ValueError
) -> Numbers:
    """Return the numbers in rows whose cells may also be blank, missing values, true or false.

    Raises ValueError for other words; its cause is ``error``, why the rows are not only numbers.
    """
    cells = [[_number_of(cell) for cell in _split(row, separator)] for row in rows]
    width = len(cells[0])
    if any(len(row) != width for row in cells):
        raise _refused(error) from error
    chosen = []
    for place in range(width):
        column = [row[place] for row in cells]
        has_numbers = any(map(is_number, column))
        is_last_blank = place == width - 1 > 0 and not any(column)
        is_words = len(names) == width and not has_numbers and any(map(bool, column))
        if not (is_last_blank or is_words):
            chosen.append(place)
    if not chosen:
        raise _refused(error) from error
    try:
        table = _loaded(["\t".join(row[k] or "nan" for k in chosen) for row in cells], "\t")
    except ValueError as second_error:
        raise _refused(second_error, chosen) from second_error
    named = [names[k] for k in chosen] if len(names) == width else names
    return _numbers(named, table, chosen)


def _number_of(cell: str) -> str:
    """Return a cell as a text that NumPy can convert to a number; empty if the value is missing."""
    text = cell.strip(' "').replace("\u2212", "-")  # the minus sign of Unicode
    small = text.lower()
    return "" if small in _MISSING_VALUES else _TRUTH.get(small, _FORTRAN.sub(r"\1e\2", text))


def _refused(error: ValueError, places: Sequence[int] = ()) -> ValueError:
    found = _NUMPY_ERROR.match(str(error))
    place = int(found["column"]) - 1 if found else 0
    return ValueError(
        f"row {found['row']} of the numbers has {one_line(found['word'], 60)} in column "
        f"{places[place] if places else place} (both counting from 0); expected a number"
        if found
        else str(error).partition("; use `usecols`")[0]  # removes NumPy's advice for programmers
    )


def _text(data: bytes | str) -> str:
    text = data if isinstance(data, str) else _of_bytes(data)
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise ValueError(f"line {line} has a zero byte. Save the table as UTF-8")
    return _EXCEL_LINE.sub("", text.removeprefix("\ufeff"))


def _of_bytes(data: bytes) -> str:
    """Decode UTF-8, UTF-16 or cp1252, which Excel writes; UnicodeDecodeError for binary data."""
    try:
        return decoded(data)
    except UnicodeDecodeError:
        if _BINARY.search(data):
            raise
        return decoded(data.decode("cp1252").encode())


def _lines(text: str, comments: str | None) -> Iterator[str]:
    for line in text.split("\n"):
        is_comment = comments and line.startswith(comments) and not line.startswith(_ERRORS)
        if line.strip() and not is_comment:
            yield line


def _separator(line: str) -> str | None:
    """Return the separator of the cells of a line; None if blanks separate cells."""
    outside = _QUOTED_TEXT.sub("0", line)
    found = next((sign for sign in _SEPARATORS if sign in outside), None)
    if found != ",":
        return found
    words = outside.split()
    has_decimals = len(words) > 1 and all(map(is_number, words))  # words such as 0,5 1,5
    return None if has_decimals and not all(map(is_number, outside.split(","))) else ","


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return [word.strip('"') for word in _WORD.findall(line)]
    try:
        return next(csv.reader([line], delimiter=separator))
    except csv.Error as error:  # this is not a ValueError
        raise ValueError(_table_error(error)) from None


def is_number(text: str) -> bool:
    """Return whether a cell is a number, which may have a decimal comma."""
    try:
        parse_number(text.strip(' "'), decimal_comma=True)
    except ValueError:
        return False
    return True


def _with_points(
    rows: list[str], separator: str | None, names: list[str], integers: bool
) -> tuple[list[str], str | None]:
    """Replace decimal commas in rows by points; return the rows and their separator of cells.

    Raises ValueError if commas are ambiguous.
    """
    if separator == "," and not any('"' in row for row in rows):
        is_one_column = len(names) == 1 and not integers
        if is_one_column and all(_DECIMAL.fullmatch(row.strip()) for row in rows):
            return [row.replace(",", ".") for row in rows], None
        _refuse_ambiguous(rows, names, integers)
        return rows, separator
    body = "\n".join(rows)
    if separator == ",":  # commas between quotes are decimal, others separate cells
        inside = [cell.strip('" ') for cell in _QUOTED_TEXT.findall(body) if _has_comma(cell)]
        _refuse_mixed(body, inside, separator)
        body = _QUOTED_TEXT.sub(
            lambda cell: cell[0][1:-1].replace(",", ".") if _has_comma(cell[0]) else cell[0], body
        )
    else:
        inside = [cell for cell in re.split(r'[;\s"]+', body) if _has_comma(cell)]
        _refuse_mixed(body, inside, separator)
        body = body.replace(",", ".")
    return body.split("\n"), separator


def _has_comma(cell: str) -> bool:
    return "," in cell and _WITH_COMMA.fullmatch(cell.strip('" ')) is not None


def _refuse_mixed(body: str, cells: list[str], separator: str | None) -> None:
    """Raise a ValueError if numbers have commas whose meaning is unclear.

    This is so if other numbers in the text ``body`` have decimal points, or if the commas of
    ``cells`` may separate thousands.
    """
    if cells and _POINT.search(body):
        raise ValueError(
            f"some numbers have commas, such as {brief(cells[0])}, and others have points. Write "
            "decimal points, and no separators of thousands"
        )
    several = [cell for cell in cells if cell.count(",") > 1]
    if several or (separator != ";" and cells and all(map(_THOUSANDS.fullmatch, cells))):
        shown = (several or cells)[0]
        raise ValueError(
            f"the comma of {brief(shown)} may be decimal or separate thousands. Write decimal "
            "points, and no separators of thousands"
        )


def _refuse_ambiguous(rows: list[str], names: list[str], integers: bool) -> None:
    """Raise a ValueError if the commas in rows may be decimal or separate columns."""
    if integers:
        return
    if not names and all(
        all(map(_DECIMAL.fullmatch, _COMMA_AND_BLANK.split(row.strip()))) for row in rows
    ):
        shown = rows[0].strip()
        raise ValueError(
            f"the line {brief(shown)} may have {shown.count(',') + 1} columns, or decimal commas "
            f"as in {brief(shown.replace(',', '.', 1))}. Name each column in the first line, or "
            f"{_ADVICE}"
        )
    widths = {row.count(",") + 1 for row in rows}
    if len(names) > 1 and widths == {2 * len(names)}:
        raise ValueError(
            f"the first line has {len(names)} names of columns, but the other lines have "
            f"{2 * len(names)} cells. If half of the commas are decimal, {_ADVICE}"
        )


def _commented_names(text: str, separator: str | None) -> list[str]:
    """Return the words of the last comment above the numbers, as np.savetxt writes names."""
    head = ""
    for line in text.split("\n"):
        if line.strip() and not line.startswith("#"):
            break
        if line.startswith("#") and line.strip("#-=_ \t\r"):  # not a ruled line
            head = line
    return [name.strip() for name in _split(head.lstrip("# "), separator)] if head else []

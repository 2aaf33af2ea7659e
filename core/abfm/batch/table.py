"""Tables of rows: comma-separated files, and all combinations of values of options."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, TypeVar

from abfm.batch.kinds import KINDS, TASK
from abfm.batch.rows import Row
from abfm.errors import ParameterError, brief, did_you_mean, one_line
from abfm.reading import Format, decoded, open_file, rows_of
from abfm.tasks.inputs import Input
from abfm.wording import counted

Read = TypeVar("Read")

NAME = "name"  # name of the column with the names of rows
_BYTES_MAX = 256 << 20
_ROWS_MAX = 1_000_000


def known_columns() -> dict[str, Input]:
    inputs = {each.name: each for task in KINDS.values() for each in task.inputs}
    return {TASK.name: TASK, **inputs}


def read_table(path: str | os.PathLike[str]) -> list[Row]:
    """Read a table of rows; relative paths are relative to the folder of the table.

    The first line has the names of the columns: names of options of `abfm match` and `abfm
    register`, ``mesh`` or ``a`` and ``b``, and optionally ``name``. The separator is the comma,
    semicolon or tab of the first line. Cells that contain a comma need double quotes. Numbers may
    have decimal commas. Empty cells count as not given, and empty lines are skipped.

    Raises
    ------
    ParameterError
        If the table cannot be read, or a cell is invalid. The message names row and column.
    """
    return of_table(path, rows_of_text)


def of_table(path: str | os.PathLike[str], read: Callable[[str, str], Read]) -> Read:
    """Call `read` with the text of a table and the folder of its relative paths; return the result.

    The name of the table is added to the message of a ParameterError in `read`.
    """
    name = one_line(path)
    try:
        opened = open_file(path)
        if opened.format not in (Format.TABLE, Format.UNKNOWN):
            raise ParameterError(f"it is {opened.format}; expected a table, such as a .csv file")
        if len(opened.data) > _BYTES_MAX:
            raise ParameterError(f"it has {len(opened.data)} bytes; at most {_BYTES_MAX} are read")
        return read(decoded(opened.data), os.fspath(opened.path.absolute().parent))
    except OSError as error:
        raise ParameterError(f"cannot read table {name}: {one_line(error)}") from error
    except UnicodeDecodeError as error:
        raise ParameterError(f"table {name}: {one_line(error)}; save it as UTF-8") from None
    except ValueError as error:
        raise ParameterError(f"table {name}: {error}") from None


def rows_of_text(text: str, folder: str | os.PathLike[str]) -> list[Row]:
    """Parse the text of a table with paths relative to a folder, see `read_table`."""
    lines = table_cells(text)
    columns = _columns(next(lines, []))
    rows = [_row(columns, cells, number, folder) for number, cells in enumerate(lines, 1)]
    if not rows:
        raise ParameterError(
            "it has no rows; expected a line with the names of columns, and a line for each row"
        )
    first: dict[str, int] = {}
    for number, row in enumerate(rows, 1):
        if first.setdefault(row.name, number) != number:
            raise ParameterError(
                f"rows {first[row.name]} and {number} are both named {brief(row.name)}; names must "
                "be unique"
            )
    return rows


def table_cells(text: str, rows_max: int = _ROWS_MAX) -> Iterator[list[str]]:
    """Yield the cells of each nonempty line: the names of columns, then at most `rows_max` rows."""
    width = 0
    try:
        for number, cells in enumerate(rows_of(text, blanks=False).cells):
            width = width or len(cells)
            if number > rows_max:
                raise ParameterError(f"it has more than {rows_max} rows")
            if len(cells) > width:
                raise ParameterError(
                    f"row {number} has {len(cells)} cells, but the table has "
                    f"{counted(width, 'column')}; put cells that contain a comma in double quotes"
                )
            yield cells
    except ValueError as error:
        raise ParameterError(str(error)) from None


def _columns(cells: Sequence[str]) -> list[str]:
    """Return the names of columns as options, such as max-distortion for max_distortion."""
    known = known_columns()
    found: list[str] = []
    for number, cell in enumerate(cells, 1):
        column = cell.lower().removeprefix("--").replace("_", "-")
        if column and column not in known and column != NAME:
            hint = did_you_mean(column, [NAME, *known])
            raise ParameterError(
                f"column {number}: {brief(cell)} is not the name of a column{hint}"
            )
        is_repeated = column in found and column and not (column in known and known[column].repeats)
        if is_repeated:
            raise ParameterError(f"column {number} repeats the name {brief(cell)}; remove it")
        found.append(column)
    return found


def _row(
    columns: Sequence[str], cells: Sequence[str], number: int, folder: str | os.PathLike[str]
) -> Row:
    options, name = [], ""
    for place, (column, cell) in enumerate(zip(columns, cells, strict=False), 1):
        if not column and cell:
            raise ParameterError(
                f"row {number}: cell {place} is in a column without a name; name the column"
            )
        if column == NAME:
            name = cell
        elif cell:
            options.append((column, cell))
    try:
        return Row(name or f"row {number}", options, folder)
    except ParameterError as error:
        raise ParameterError(f"row {number}, {error}") from None
    except ValueError as error:
        raise ParameterError(f"row {number}: {error}") from None


def combinations(
    fixed: Iterable[tuple[str, Any]],
    over: Mapping[str, Sequence[Any]],
    folder: str | os.PathLike[str] = ".",
) -> list[Row]:
    """Return a row for each combination of values of options; the last option varies fastest.

    The name of a row lists these values, as in ``alpha 0.1, sigma 0.05``.

    Parameters
    ----------
    fixed : iterable of pairs
        Options that all rows share.
    over : mapping
        Values of each option that varies.
    folder : path, optional
        Folder of relative paths; by default the current folder.

    Raises
    ------
    ParameterError
        If an option is both fixed and varied, or a value is invalid.
    """
    fixed = list(fixed)
    for option in over:
        if any(option == name for name, value in fixed if value is not None):
            raise ParameterError(
                f"{option} has both a fixed value and a list of values; give only one of them"
            )
        if not over[option]:
            raise ParameterError(f"{option} has an empty list of values; give at least one")
    count = 1
    for values in over.values():
        count *= len(values)
    if count > _ROWS_MAX:
        raise ParameterError(
            f"there are {count} combinations, but at most {_ROWS_MAX} rows are allowed"
        )
    rows = []
    for values in product(*over.values()):
        chosen = list(zip(over, values, strict=True))
        name = ", ".join(f"{option} {value}" for option, value in chosen)
        rows.append(Row(name, [*fixed, *chosen], folder))
    return rows

"""Functions read from a file: one value per vertex of the mesh file."""

import csv
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from abfm.errors import FunctionError, brief, did_you_mean, one_line
from abfm.functions.family import WORD, Family, file_name, parameter
from abfm.mesh import TriangleMesh
from abfm.reading import array_from, gifti_arrays, read_bytes
from abfm.types import FloatArray

_NO_NUMBER = re.compile(  # NumPy's words, which count rows from 0 and columns from 1
    r"could not convert string (?P<word>.*) to float64 at row (?P<row>\d+), column (?P<column>\d+)",
    re.DOTALL,
)
SUFFIXES = (".npy", ".csv", ".txt", ".gii", ".gii.gz", ".vts")


@dataclass(frozen=True, kw_only=True)
class ValuesFile(Family):
    """Values from a .npy, .csv, .txt or .gii(.gz) file, in its own unit: one per vertex, as the
    mesh file counts.

    See :func:`read_table` for the formats.
    """

    family: ClassVar[str] = "file"
    positional: ClassVar[str | None] = "path"
    path: str = parameter(file_name(*SUFFIXES), ".npy, .csv, .txt or .gii")
    column: str | None = parameter(
        WORD, "column by its name or number, counted from 0", default=None
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        values = read_column(self.path, self.column)
        try:
            return mesh.restrict(values)
        except FunctionError as error:
            raise FunctionError(f"file {brief(self.path)}: {error}") from None


def read_column(path: str, column: str | None = None) -> FloatArray:
    """Read one column of numbers, (n,); see :func:`read_table` for the formats.

    Parameters
    ----------
    column : str, optional
        Name, or number counted from 0; must be given where there are several columns.

    Raises
    ------
    FunctionError
        If the file cannot be read, is no table of numbers, or has no such column.
    """
    names, table = read_table(path)
    count = table.shape[1]
    if column is None and count == 1:
        return table[:, 0]
    if column in names:
        return table[:, names.index(column)]
    if column is not None and len(column) < 10 and column.isdecimal() and int(column) < count:
        return table[:, int(column)]
    listed = f" or one of {', '.join(one_line(name, 30) for name in names[:8])}" if names else ""
    asked = "" if column is None else f", none called {brief(column)}{did_you_mean(column, names)}"
    raise FunctionError(
        f"file {brief(path)} has {count} columns{asked}; choose column=0 to {count - 1}{listed}"
    )


def read_table(path: str) -> tuple[list[str], FloatArray]:
    """Read the names of the columns, if there are any, and the numbers, (n, c).

    .npy holds an array (n,) or (n, c), no pickle. .csv, .txt and .vts hold lines of numbers
    separated by commas, semicolons, tabs or blanks, with or without a line of names on top; empty
    lines and lines starting with ``#`` are skipped. .gii is GIFTI, whose data arrays are the
    columns.

    Raises
    ------
    FunctionError
        If the file cannot be read or is no table of numbers.
    """
    suffix = next((suffix for suffix in SUFFIXES if path.lower().endswith(suffix)), None)
    if suffix is None:
        raise FunctionError(f"file {brief(path)}: the name must end in {', '.join(SUFFIXES)}")
    read = {".npy": _read_npy, ".gii": _read_gifti, ".gii.gz": _read_gifti}.get(suffix, _read_text)
    try:
        return read(Path(os.path.expanduser(path)))
    except OSError as error:
        raise FunctionError(f"file {brief(path)} cannot be read: {one_line(error)}") from error
    except Exception as error:  # whatever a broken file makes of the readers
        raise FunctionError(
            f"file {brief(path)} is not a table of numbers: {one_line(error)}"
        ) from error


def _as_table(values: np.ndarray) -> FloatArray:
    if values.dtype.kind not in "biuf" or values.ndim not in (1, 2):
        raise ValueError(
            f"an array of {values.dtype} with shape {values.shape}; real numbers (n,) or (n, c) "
            "expected"
        )
    return values.reshape(len(values), -1).astype(np.float64)


def _read_npy(path: Path) -> tuple[list[str], FloatArray]:
    return [], _as_table(array_from(read_bytes(path)))


def _read_gifti(path: Path) -> tuple[list[str], FloatArray]:
    columns = [array.values for array in gifti_arrays(path)]
    if not columns:
        raise ValueError("it holds no data array")
    return [], _as_table(np.column_stack(columns))


def _read_text(path: Path) -> tuple[list[str], FloatArray]:
    text = read_bytes(path).decode("utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise ValueError("it is empty")
    delimiter = next((sign for sign in ";,\t" if sign in lines[0]), None)
    first = (
        lines[0].split() if delimiter is None else next(csv.reader(lines[:1], delimiter=delimiter))
    )
    names = [] if all(map(_is_number, first)) else [name.strip() for name in first]
    rows = lines[1:] if names else lines
    if not rows:
        raise ValueError(f"it has only the line {brief(lines[0])}")
    try:
        table = np.loadtxt(rows, delimiter=delimiter, comments=None, quotechar='"', ndmin=2)
    except ValueError as error:
        found = _NO_NUMBER.match(str(error))
        raise ValueError(
            f"row {found['row']} of its numbers, counting from 0, has "
            f"{one_line(found['word'], 60)} in column "
            f"{int(found['column']) - 1}, where a number is expected"
            if found
            else str(error).partition("; use `usecols`")[0]  # which is advice to who programs
        ) from error
    return names if len(names) == table.shape[1] else [], table  # other words on top are a title


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True

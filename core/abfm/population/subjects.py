"""Subjects of a population: their files, and the table that lists them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from abfm.batch.table import of_table, table_cells
from abfm.errors import AbfmError, ParameterError, brief, one_line
from abfm.functions import parse, quoted
from abfm.population.settings import WEIGHT_MAX
from abfm.reading.text_tables import parse_number
from abfm.tasks.inputs import absolute, renamed_spec
from abfm.wording import counted

HELD_OUT_PREFIX = "held-out:"
"""Prefix of the column of a channel that is transferred but not used for registration."""
_SUBJECT_COLUMNS = ("name", "surface", "mask", "weight", "landmarks")
_ROWS_MAX = 100_000


@dataclass(frozen=True)
class Channel:
    """A function of each subject. A held-out channel only measures the quality of the maps."""

    name: str
    is_held_out: bool = False


@dataclass(frozen=True)
class Subject:
    """A subject, described by texts: file names and function specifications.

    Attributes
    ----------
    name : str
    functions : tuple of str
        Specification of each channel, such as ``file:/data/s1/lh.sulc``. The specification of an
        unknown held-out channel is empty.
    surface : str
        The mesh file; empty for the template itself.
    mask : str
        Specification of nonnegative weights of the vertices; empty for 1 everywhere.
    weight : float
        Weight in means. A subject of weight 0 is also registered and checked.
    landmarks : str
        File of corresponding points of the subject and the template, see
        `abfm.registration.read_landmarks`; empty for none.
    """

    name: str
    functions: tuple[str, ...]
    surface: str = ""
    mask: str = ""
    weight: float = 1.0
    landmarks: str = ""


@dataclass(frozen=True)
class Cohort:
    """Subjects with the same channels and unique names.

    Raises
    ------
    ParameterError
        If there are fewer than two subjects or no channel for registration. Also if a name is
        repeated or unprintable, functions are missing, or weights are not finite, negative, or all
        0.
    """

    channels: tuple[Channel, ...]
    subjects: tuple[Subject, ...]

    def __post_init__(self) -> None:
        if (count := len(self.subjects)) < 2:
            raise ParameterError(f"the number of subjects is {count}; expected at least 2")
        if all(channel.is_held_out for channel in self.channels):
            raise ParameterError(
                "there is no channel for registration; add a column of functions without the "
                f"prefix {HELD_OUT_PREFIX}. Landmarks alone do not define a mean"
            )
        _require_unique("channel", [channel.name for channel in self.channels])
        _require_unique("subject", [subject.name for subject in self.subjects])
        for subject in self.subjects:
            self._check(subject)
        if not any(subject.weight for subject in self.subjects):
            raise ParameterError("all subjects have weight 0; at least one weight must be positive")

    def _check(self, subject: Subject) -> None:
        label = f"subject {one_line(subject.name, 60)}"
        if not math.isfinite(subject.weight) or not 0 <= subject.weight <= WEIGHT_MAX:
            raise ParameterError(
                f"{label} has weight {subject.weight:g}; expected a number from 0 to {WEIGHT_MAX:g}"
            )
        if len(subject.functions) != len(self.channels):
            raise ParameterError(
                f"{label} has {counted(len(subject.functions), 'function')} for "
                f"{counted(len(self.channels), 'channel')}; give one function for each"
            )
        for channel, text in zip(self.channels, subject.functions, strict=True):
            if not text and not channel.is_held_out:
                raise ParameterError(
                    f"{label} has no function {one_line(channel.name, 60)}; each subject needs all "
                    "channels that are not held out"
                )

    @property
    def registered_channels(self) -> list[int]:
        """Indices of the channels that are not held out."""
        return [c for c, channel in enumerate(self.channels) if not channel.is_held_out]


def read_subjects(path: str | os.PathLike[str]) -> Cohort:
    """Read a table of subjects; relative paths are relative to the folder of the table.

    The first line has the names of the columns. Separators are commas, semicolons or tabs, as in
    the first line. Cells that contain a comma need double quotes. Empty lines are skipped.

    Columns with these names describe the subjects:

    - ``name``: name of the subject.
    - ``surface``: mesh file; the template if the cell is empty.
    - ``mask``: weights of the vertices, see `Subject`.
    - ``weight``: weight in means.
    - ``landmarks``: file of landmarks, see `abfm.registration.read_landmarks`.

    Any other column is a channel with this name. The prefix ``held-out:`` marks a held-out channel.
    The cells of channels and masks are files of values or function specifications.

    Raises
    ------
    ParameterError
        If the table cannot be read, or a cell is invalid. The message names row and column.
    """
    return of_table(path, _cohort)


def function_text(given: str, folder: str | os.PathLike[str]) -> str:
    """Return the function specification of a text: the name of a values file or a specification.

    File names in the text are relative to ``folder``; those in the result are absolute. Raises
    AbfmError if the text is neither an existing file nor a function specification.
    """
    path = Path(folder, os.path.expanduser(given))
    try:
        is_file = path.is_file()
    except (OSError, ValueError):  # the text is not a valid file name
        is_file = False
    if is_file:
        return f"file:{quoted(os.fspath(path))}"
    parse(given)
    return renamed_spec(given, absolute(os.fspath(folder)))


def _cohort(text: str, folder: str) -> Cohort:
    lines = table_cells(text, _ROWS_MAX)
    if (names := next(lines, None)) is None:
        raise ParameterError(
            "it is empty; expected a line with the names of columns, and a line for each subject"
        )
    columns = _columns(names)
    subjects = [_subject(columns, cells, number, folder) for number, cells in enumerate(lines, 1)]
    return Cohort(tuple(map(_channel, _channels(columns))), tuple(subjects))


def _columns(cells: Sequence[str]) -> list[str]:
    """Return the checked names of the columns, in lower case except those of channels."""
    found = []
    for number, cell in enumerate(cells, 1):
        if not cell:
            raise ParameterError(f"column {number} has no name; name the column")
        found.append(cell.lower() if cell.lower() in _SUBJECT_COLUMNS else cell)
    _require_unique("column", found)
    return found


def _channels(columns: Sequence[str]) -> list[str]:
    return [column for column in columns if column not in _SUBJECT_COLUMNS]


def _channel(column: str) -> Channel:
    name = column.removeprefix(HELD_OUT_PREFIX).strip()
    if not name:
        raise ParameterError(
            f"column {brief(column)} has no channel name; expected {HELD_OUT_PREFIX}NAME"
        )
    return Channel(name, column.startswith(HELD_OUT_PREFIX))


def _subject(columns: Sequence[str], cells: Sequence[str], number: int, folder: str) -> Subject:
    given = dict(zip(columns, cells, strict=False))
    paths = [given.get(column) for column in ("surface", "landmarks")]
    surface, landmarks = (absolute(folder)(path) if path else "" for path in paths)
    return Subject(
        given.get("name") or f"row {number}",
        tuple(_value(given, column, number, folder) for column in _channels(columns)),
        surface,
        _value(given, "mask", number, folder),
        _weight(given.get("weight", ""), number),
        landmarks,
    )


def _value(given: Mapping[str, str], column: str, number: int, folder: str) -> str:
    text = given.get(column, "")
    try:
        return function_text(text, folder) if text else ""
    except AbfmError as error:
        reason = f"the file {brief(text)} does not exist"
        if ":" in text or not Path(text).suffix:
            reason += f", and it is not a function: {error}"
        raise ParameterError(f"row {number}, column {one_line(column, 60)}: {reason}") from None


def _weight(text: str, row: int) -> float:
    try:
        return parse_number(text) if text else 1.0
    except ValueError as error:
        raise ParameterError(
            f"row {row}: the weight {brief(text)} is not a number ({one_line(error)})"
        ) from None


def _require_unique(noun: str, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if not name or not name.isprintable():
            raise ParameterError(
                f"{brief(name)} is not a valid name of a {noun}; expected printable characters"
            )
        if name in seen:
            raise ParameterError(
                f"two {noun}s are named {one_line(name, 60)}; names must be unique"
            )
        seen.add(name)

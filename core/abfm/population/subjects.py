"""Subjects of a population, by the files that hold them, and the table that names these."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from abfm.batch.table import of_table, table_cells
from abfm.errors import AbfmError, ParameterError, brief, one_line
from abfm.functions import parse, quoted
from abfm.population.settings import LARGEST_WEIGHT
from abfm.reading.text_tables import parse_number
from abfm.tasks.inputs import absolute, renamed_spec

HELD_TAG = "held-out:"
"""How the column of a channel begins that is carried, but not registered by."""
_OWN_COLUMNS = ("name", "surface", "mask", "weight", "landmarks")
_MOST_ROWS = 100_000


@dataclass(frozen=True)
class Channel:
    """A function that all subjects have; one that is held out only tells how good maps are."""

    name: str
    is_held_out: bool = False


@dataclass(frozen=True)
class Subject:
    """A subject, as texts: a surface, and functions on it.

    Attributes
    ----------
    name : str
    functions : tuple of str
        A function as text for each channel, such as ``file:/data/s1/lh.sulc``; empty where a
        channel that is held out is not known.
    surface : str
        The mesh file; empty for the template itself.
    mask : str
        How much its vertices count: a function, not negative; empty for 1 everywhere.
    weight : float
        How much it counts in means; one of weight 0 is registered and judged all the same.
    landmarks : str
        A file of points of it and of the template that belong together, see
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
    """Subjects that have the same channels, each of its own name.

    Raises
    ------
    ParameterError
        If there are fewer than two subjects or no channel to register by, a name is there twice or
        cannot be printed, functions are lacking, or weights are not finite, negative, or all 0.
    """

    channels: tuple[Channel, ...]
    subjects: tuple[Subject, ...]

    def __post_init__(self) -> None:
        if len(self.subjects) < 2:
            raise ParameterError(f"subjects: {len(self.subjects)}; a population has two or more")
        if all(channel.is_held_out for channel in self.channels):
            raise ParameterError(
                "there is no channel to register by: give a column with functions, not "
                f"beginning with {HELD_TAG}; landmarks alone make no mean to register to"
            )
        _require_once("channel", [channel.name for channel in self.channels])
        _require_once("subject", [subject.name for subject in self.subjects])
        for subject in self.subjects:
            self._check(subject)
        if not any(subject.weight for subject in self.subjects):
            raise ParameterError("all subjects have weight 0; give one of them more")

    def _check(self, subject: Subject) -> None:
        told = f"subject {one_line(subject.name, 60)}"
        if not math.isfinite(subject.weight) or not 0 <= subject.weight <= LARGEST_WEIGHT:
            raise ParameterError(
                f"{told} has weight {subject.weight:g}; expected a number from 0 to "
                f"{LARGEST_WEIGHT:g}"
            )
        if len(subject.functions) != len(self.channels):
            raise ParameterError(
                f"{told} has {len(subject.functions)} functions for {len(self.channels)} "
                "channels; give one each"
            )
        for channel, text in zip(self.channels, subject.functions, strict=True):
            if not text and not channel.is_held_out:
                raise ParameterError(
                    f"{told} has no {one_line(channel.name, 60)}: each subject needs all channels "
                    "that it is registered by"
                )

    @property
    def registered_by(self) -> list[int]:
        """The numbers of the channels that are not held out."""
        return [c for c, channel in enumerate(self.channels) if not channel.is_held_out]


def read_subjects(path: str | os.PathLike[str]) -> Cohort:
    """Read a table of subjects; relative paths in it begin at its folder.

    The first line names the columns: ``name``, and maybe ``surface`` (a mesh file, the template
    where it is empty), ``mask``, ``weight`` and ``landmarks`` (a file, see
    `abfm.registration.read_landmarks`); each other one is a channel by its name, held out where it
    begins with ``held-out:``. A cell of a channel, or of masks, is a file of values or a
    function as text. Commas, semicolons or tabs separate cells, as in the first line; one with a
    comma in it stands in double quotes. Empty lines are skipped.

    Raises
    ------
    ParameterError
        If it cannot be read, or what it holds does not fit: in which row and column.
    """
    return of_table(path, _cohort)


def function_text(given: str, folder: str | os.PathLike[str]) -> str:
    """Return a file of values, or a function, as the text of a function whose files are absolute.

    Raises
    ------
    AbfmError
        If it is neither: no such file, and no text of a function.
    """
    path = Path(folder, os.path.expanduser(given))
    try:
        is_file = path.is_file()
    except (OSError, ValueError):  # no name of a file
        is_file = False
    if is_file:
        return f"file:{quoted(os.fspath(path))}"
    parse(given)
    return renamed_spec(given, absolute(os.fspath(folder)))


def _cohort(text: str, folder: str) -> Cohort:
    lines = table_cells(text, _MOST_ROWS)
    if (names := next(lines, None)) is None:
        raise ParameterError("it is empty: expected a line of names of columns, and more below")
    columns = _columns(names)
    subjects = [_subject(columns, cells, number, folder) for number, cells in enumerate(lines, 1)]
    return Cohort(tuple(map(_channel, _channels(columns))), tuple(subjects))


def _columns(cells: Sequence[str]) -> list[str]:
    """Return the columns' names, those of our own in small letters."""
    found = []
    for number, cell in enumerate(cells, 1):
        if not cell:
            raise ParameterError(f"column {number} has no name; give it one")
        found.append(cell.lower() if cell.lower() in _OWN_COLUMNS else cell)
    _require_once("column", found)
    return found


def _channels(columns: Sequence[str]) -> list[str]:
    return [column for column in columns if column not in _OWN_COLUMNS]


def _channel(column: str) -> Channel:
    name = column.removeprefix(HELD_TAG).strip()
    if not name:
        raise ParameterError(f"column {brief(column)} has no name of a channel; give it one")
    return Channel(name, column.startswith(HELD_TAG))


def _subject(columns: Sequence[str], cells: Sequence[str], number: int, folder: str) -> Subject:
    given = dict(zip(columns, cells, strict=False))
    surface, landmarks = (
        absolute(folder)(path) if (path := given.get(column)) else ""
        for column in ("surface", "landmarks")
    )
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
        why = f"there is no file {brief(text)}"
        if ":" in text or not Path(text).suffix:
            why += f", and as a function it is none: {error}"
        raise ParameterError(f"row {number}, column {one_line(column, 60)}: {why}") from None


def _weight(text: str, row: int) -> float:
    try:
        return parse_number(text) if text else 1.0
    except ValueError as error:
        raise ParameterError(f"row {row}: weight {brief(text)}: {one_line(error)}") from None


def _require_once(what: str, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if not name or not name.isprintable():
            raise ParameterError(
                f"a {what} is called {brief(name)}; give it a name that can be printed"
            )
        if name in seen:
            raise ParameterError(f"two {what}s are called {one_line(name, 60)}; rename one")
        seen.add(name)

"""Tasks: each kind of problem is declared once, for the command line, tables, files and views."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, Self

from abfm.errors import ResultError, one_line
from abfm.io import results
from abfm.mesh import TriangleMesh
from abfm.outcome import Facts
from abfm.tasks.inputs import Input
from abfm.tasks.monitor import Monitor
from abfm.types import File, FloatArray


class Preview(NamedTuple):
    """Functions (V,) on a surface that a small picture of a result shows."""

    mesh: TriangleMesh
    functions: list[FloatArray]


def preview_of(
    path: Path, file: results.FileKind, functions: Callable[..., list[FloatArray]]
) -> Preview:
    """Return the functions that are made of the arrays of a file, and its surface.

    Raises
    ------
    ResultError
        If the file is missing or damaged.
    """
    arrays = results.load_arrays(path, file)
    try:
        mesh = results.mesh_of(arrays)
    except ValueError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error)}; {results.MEND}") from error
    return Preview(mesh, functions(arrays))


class Result(Protocol):
    """What solving a task gives."""

    @property
    def facts(self) -> Facts:
        """Return what every view reports of it."""

    def save(self, path: File) -> None:
        """Write the file, completely or not at all."""

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write what can be written of a result that `save` refuses; return what is missing."""


class Export(NamedTuple):
    """A format of data files that a result can be written to."""

    write: Callable[[Path, Any], object]
    """Write a result. A returned text reports what the file lacks."""
    check: Callable[[Path], object] = lambda path: None
    """Refuse a path before anything is solved, by an AbfmError."""


class Table(NamedTuple):
    """A table of a result as a CSV file."""

    help: str
    write: Callable[[Path, Any], object]


class ResultFile(NamedTuple):
    """How the files of a kind of results are recognized and read."""

    marks: frozenset[str]
    """Arrays that a file of this kind has, and files of other kinds do not have all of."""
    load: Callable[..., Any]
    """Read a result; ResultError if it is missing, damaged or of another kind."""
    facts: Callable[[Path], Facts]
    """Return the facts that a file holds, without reading all of it; ResultError as of load."""
    preview: Callable[[Path], Preview]
    """Read the functions of a small picture, named by `Task.preview_labels`."""


def _advice(found: Any, result: str) -> str:
    return str(found.facts.advice)


class Report(NamedTuple):
    """What is reported of a kind of results."""

    details: Callable[[Any], dict[str, Any]]
    """Return all that is reported as plain numbers and texts; None for unknown."""
    lines: Callable[[Any], list[str]]
    """Return the report for people, a line each."""
    advice: Callable[[Any, str], str] = _advice
    """Return what to try next; the text is the file of the result, empty without one."""


class Given(Protocol):
    """The inputs of a task, as read from a row of a table or from a command line."""

    def values(self) -> dict[str, Any]:
        """Return values by name, repeated ones as lists; names of files are absolute."""

    @property
    def written(self) -> Mapping[str, Any]:
        """The same with names of files as they were written."""

    @property
    def key(self) -> str:
        """Name by values and contents of files, in hexadecimal digits."""


class Task(ABC):
    """A problem with all of its inputs: immutable, and can be pickled.

    A subclass declares a kind of task. Its inputs become options of its command and columns of
    tables, its exports formats of files; no view needs to know which kind it shows.

    Attributes
    ----------
    kind : str
        Name of the kind.
    summary, description : str
        What ``--help`` says of the command that solves it: a line, and a text with examples.
    output_help : str
        What ``--help`` says of the option ``--out``.
    inputs : tuple of Input
        In the order of ``--help``.
    needs : tuple of str
        Names of the inputs that must be given; the first tells which kind a row is of.
    result : type
        Of its results.
    file : ResultFile
    report : Report
    exports : mapping of str to Export
        Formats of data files by their suffix, besides ``.npz``.
    key : str
        Of a task, unless its digest is that of a problem: the name of its row.
    tables : mapping of str to Table
        Tables of a result by the option that names their file.
    preview_labels : tuple of str
        Names of the functions in a small picture of a result.
    """

    kind: ClassVar[str]
    summary: ClassVar[str] = ""
    description: ClassVar[str] = ""
    output_help: ClassVar[str] = ""
    inputs: ClassVar[tuple[Input, ...]]
    needs: ClassVar[tuple[str, ...]]
    result: ClassVar[type[Any]]
    file: ClassVar[ResultFile]
    report: ClassVar[Report]
    exports: ClassVar[Mapping[str, Export]] = {}
    tables: ClassVar[Mapping[str, Table]] = {}
    preview_labels: ClassVar[tuple[str, ...]] = ("source", "carried", "target")
    key: str

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Refuse values that do not fit together, by an AbfmError, before files are read."""
        return

    @classmethod
    @abstractmethod
    def read(cls, given: Given) -> Self:
        """Return the task of given inputs; an AbfmError reports what does not fit."""

    @property
    def digest(self) -> str:
        """Name of the result by the content of the task, in hexadecimal digits."""
        return self.key

    @abstractmethod
    def solve(self, monitor: Monitor) -> Any:
        """Return the result; an AbfmError reports what does not fit."""

    def expected(self) -> Facts | None:
        """Return what the inputs alone say of the result; None if they say nothing."""
        return None

    @property
    def goal(self) -> float | None:
        """The residual that counts as matched; None for tasks without one."""
        return None

    def notes(self) -> list[str]:
        """Return what the caller should know of the inputs, one line each."""
        return []

    def check_export(self, path: Path) -> None:
        """Refuse a file of the result that the task rules out, by an AbfmError."""
        return

"""Base class of tasks: declarations of problems for the command line, tables, files and views."""

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
    """Functions (V,) on a surface, for a small picture of a result."""

    mesh: TriangleMesh
    functions: list[FloatArray]


def preview_of(
    path: Path, file: results.FileKind, functions: Callable[..., list[FloatArray]]
) -> Preview:
    """Read the surface of a file, and functions computed from its arrays.

    ResultError if the file is missing or damaged.
    """
    arrays = results.load_arrays(path, file)
    try:
        mesh = results.mesh_of(arrays)
    except ValueError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error)}. {results.REMEDY}") from error
    return Preview(mesh, functions(arrays))


class Result(Protocol):
    @property
    def facts(self) -> Facts:
        """Facts of the result for reports, pages and panels."""

    def save(self, path: File) -> None:
        """Write the file, completely or not at all."""

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write the valid parts of a result that `save` refuses, and return the missing parts."""


class Export(NamedTuple):
    """A format of data files for results."""

    write: Callable[[Path, Any], object]
    """Write a result. A returned text reports what the file lacks."""
    check: Callable[[Path], object] = lambda path: None
    """Raise an AbfmError if a path cannot be used; called before the task is solved."""


class Table(NamedTuple):
    """A table of a result, written as a CSV file."""

    help: str
    write: Callable[[Path, Any], object]


class ResultFile(NamedTuple):
    """Functions that recognize and read the files of one type of result."""

    required_entries: frozenset[str]
    """Entries of a file that together identify this type of result."""
    load: Callable[..., Any]
    """Load a result; ResultError if the file is missing, damaged or of another type."""
    facts: Callable[[Path], Facts]
    """Read the facts without loading the complete file; raises the errors of `load`."""
    preview: Callable[[Path], Preview]
    """Read the functions of a small picture; `Task.preview_labels` names them."""


def _advice(found: Any, result: str) -> str:
    return str(found.facts.advice)


class Report(NamedTuple):
    """Functions that report on one type of result."""

    details: Callable[[Any], dict[str, Any]]
    """Return all reported values as plain numbers and texts; None if a value is unknown."""
    lines: Callable[[Any], list[str]]
    """Return the lines of the printed report."""
    advice: Callable[[Any, str], str] = _advice
    """Return what to try next. The text is the path of the result; empty without a file."""


class TaskInputs(Protocol):
    """Protocol of the inputs of a task, read from a row of a table or from a command line."""

    def values(self) -> dict[str, Any]:
        """Return values by name, repeated ones as lists; file names are absolute."""

    @property
    def written(self) -> Mapping[str, Any]:
        """Values by name, with file names as the user wrote them."""

    @property
    def key(self) -> str:
        """Hash of the values and the contents of files, in hexadecimal digits."""


class Task(ABC):
    """An immutable, picklable problem with all of its inputs.

    A subclass declares a type of task. Its inputs become options of a command and columns of
    tables; its exports become formats of files. Views use only this declaration, never the
    subclass.

    Attributes
    ----------
    kind : str
        Name of the type of task.
    summary, description, details : str
        Help of the command that solves the task: one line, a short text with examples, and the long
        explanations that only ``--help-all`` prints.
    output_help : str
        Help of the option ``--out``.
    inputs : tuple of Input
        Inputs in the order of ``--help-all``.
    main_options : tuple of str
        Names of the options that ``--help`` shows.
    needs : tuple of str
        Names of the required inputs. The first one identifies the type of task of a row.
    result : type
        Type of the task's results.
    file : ResultFile
    report : Report
    exports : mapping of str to Export
        Formats of data files by suffix, in addition to ``.npz``.
    key : str
        Key of the task's row, which names the result unless the subclass overrides `digest`.
    tables : mapping of str to Table
        Tables of a result, by the option that names the file.
    preview_labels : tuple of str
        Labels of the functions in a small picture of a result.
    """

    kind: ClassVar[str]
    summary: ClassVar[str] = ""
    description: ClassVar[str] = ""
    details: ClassVar[str] = ""
    output_help: ClassVar[str] = ""
    inputs: ClassVar[tuple[Input, ...]]
    main_options: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]]
    result: ClassVar[type[Any]]
    file: ClassVar[ResultFile]
    report: ClassVar[Report]
    exports: ClassVar[Mapping[str, Export]] = {}
    tables: ClassVar[Mapping[str, Table]] = {}
    preview_labels: ClassVar[tuple[str, ...]] = ("source", "advected", "target")
    key: str

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Raise an AbfmError if values do not fit together; called before files are read."""
        return

    @classmethod
    @abstractmethod
    def read(cls, given: TaskInputs) -> Self:
        """Create the task from its inputs; raise an AbfmError if they do not fit together."""

    @property
    def digest(self) -> str:
        """Name of the result, computed from the inputs, in hexadecimal digits."""
        return self.key

    @abstractmethod
    def solve(self, monitor: Monitor) -> Any:
        """Solve the task and return the result, or raise an AbfmError if its inputs are invalid."""

    def expected(self) -> Facts | None:
        """Return the facts that the inputs alone determine; None if there are none."""
        return None

    @property
    def goal(self) -> float | None:
        """Residual below which a result counts as matched; None for tasks without a goal."""
        return None

    def notes(self) -> list[str]:
        """Return notes on the inputs, one line each."""
        return []

    def check_export(self, path: Path) -> None:
        """Raise an AbfmError if the task cannot write its result to this file."""
        return

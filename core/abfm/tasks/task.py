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
from abfm.parameters import in_options
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
    """Return the surface of a result file, with functions (V,) computed from its arrays."""
    arrays = results.load_arrays(path, file)
    try:
        mesh = results.mesh_of(arrays)
    except ValueError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error)}. {results.REMEDY}") from error
    return Preview(mesh, functions(arrays))


class Result(Protocol):
    @property
    def facts(self) -> Facts:
        """Facts of the result for reports: outcome, numbers and warnings."""

    def save(self, path: File) -> None:
        """Write the result to a file, completely or not at all."""

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write the valid parts of a result that `save` refuses; return names of missing parts."""


class Export(NamedTuple):
    """A file format to which results can be exported."""

    write: Callable[[Path, Any], object]
    """Write a result to a path. The function may return a text on data missing in the file."""
    check: Callable[[Path], object] = lambda path: None
    """Raise an AbfmError if a path cannot be used; called before the task is solved."""


class Table(NamedTuple):
    """A table of a result, written as a CSV file."""

    help: str
    write: Callable[[Path, Any], object]


class ResultFile(NamedTuple):
    """Functions that recognize and read the files of one type of result."""

    required_entries: frozenset[str]  # entries of a file that together identify this type of result
    load: Callable[..., Any]
    """Load a result; ResultError if the file is missing, damaged or of another type."""
    facts: Callable[[Path], Facts]
    """Read the facts without loading the complete file; raises the errors of `load`."""
    preview: Callable[[Path], Preview]
    """Read the functions for a small picture of a result; `Task.preview_labels` labels them."""


class Report(NamedTuple):
    """Functions that report on one type of result."""

    details: Callable[[Any], dict[str, Any]]
    """Return all reported values as plain numbers and texts; None if a value is unknown."""
    lines: Callable[[Any], list[str]]  # return the lines of the printed report
    advice: Callable[[Any, str], str] = lambda found, result: in_options(found.facts.advice)
    """Return advice on the next run. The second argument is the path of the result, or empty."""


class TaskInputs(Protocol):
    """Protocol of the inputs of a task, read from a row of a table or from a command line."""

    def values(self) -> dict[str, Any]:
        """Return the parsed values by name, those of repeatable inputs in lists.

        File names are absolute.
        """

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
    """

    kind: ClassVar[str]  # name of the type of task
    summary: ClassVar[str] = ""  # help of the command, one line
    description: ClassVar[str] = ""  # help of the command, a short text with examples
    details: ClassVar[str] = ""  # long explanations that only ``--help-all`` prints
    output_help: ClassVar[str] = ""  # help of the option ``--out``
    inputs: ClassVar[tuple[Input, ...]]  # inputs in the order of ``--help-all``
    # options that ``--help`` shows, besides arguments and required options
    main_options: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]]  # names of required inputs; the first one identifies the type
    result: ClassVar[type[Any]]  # type of the results
    file: ClassVar[ResultFile]
    report: ClassVar[Report]
    exports: ClassVar[Mapping[str, Export]] = {}  # formats by suffix, in addition to ``.npz``
    tables: ClassVar[Mapping[str, Table]] = {}  # tables by the option that names the file
    # labels of the functions in a small picture of a result
    preview_labels: ClassVar[tuple[str, ...]] = ("source", "advected", "target")
    key: str  # key of the row; it names the result unless the subclass overrides `digest`

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Raise an AbfmError if the inputs are inconsistent; called before files are read."""
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
        """Return facts known before solving, such as an impossible match; else None."""
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

"""Loading of results and problems of every kind from files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from abfm.batch.kinds import KINDS
from abfm.errors import ResultError, brief
from abfm.io import results
from abfm.matching.problem import load_problem
from abfm.matching.result import load_match
from abfm.population.task import PopulationTask
from abfm.registration.correspondence import load_correspondence
from abfm.tasks.task import Task
from abfm.types import File

_TASKS: tuple[type[Task], ...] = (PopulationTask, *KINDS.values())


def load(path: File, *expected: type) -> Any:
    """Load a result or a problem from its file.

    Parameters
    ----------
    path : path or open binary file
        A file written by `save`, or the folder of a population.
    *expected : type
        Accepted types of the result. By default all types are accepted.

    Returns
    -------
    Match, Registration, Correspondence, Sequence, Population or Problem
        The content of the file. Stored values that do not fit the field of a match are recomputed,
        and ``match.load_warning`` reports it.

    Raises
    ------
    ResultError
        If the file is missing or damaged, or contains none of the expected types.
    """
    found = _loaded(path)
    if expected and not isinstance(found, expected):
        kind, names = type(found).__name__, " or ".join(each.__name__ for each in expected)
        text = f"contains a {kind}; expected a {names}".lower()
        raise ResultError(f"{results.name_of(path)} {text} (`abfm info` describes the file)")
    return found


def _loaded(path: File) -> Any:
    if isinstance(path, str | os.PathLike) and Path(path).is_dir():
        return PopulationTask.file.load(path)
    names = _names(path)
    if (task := _task(names)) is not None:
        return task.file.load(path)
    if "a_vertices" in names:
        return load_correspondence(path)
    if {"source", "target"} <= names:
        # a damaged match must not be read as a problem
        is_match = names & (results.RESULT.entries.keys() - results.PROBLEM.entries.keys())
        return load_match(path) if is_match else load_problem(path)
    raise ResultError(
        f"{results.name_of(path)} contains no result or problem of abfm; expected a file written "
        "by save()"
    )


def task_of_file(path: File) -> type[Task] | None:
    """Return the type of task whose result a file contains; None for other archives of arrays.

    Raises ResultError if the file is missing or damaged.
    """
    names = _names(path)
    return _task(names) if "format_version" in names else None


def _names(path: File) -> set[str]:
    with results.open_archive(path, results.RESULT.name, results.REMEDY) as archive:
        return set(archive)


def _task(names: set[str]) -> type[Task] | None:
    """Return the type of task whose result file has arrays of these names; None if none fits."""
    fitting = [task for task in _TASKS if task.file.required_entries <= names]
    return max(fitting, key=lambda task: len(task.file.required_entries), default=None)


def task_of(found: Any) -> type[Task]:
    for task in _TASKS:
        if type(found) is task.result:
            return task
    raise ResultError(f"{brief(found)} is not the result of a task")

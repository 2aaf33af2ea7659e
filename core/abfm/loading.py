"""Results of all kinds: read from files, and the tasks that they are results of."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from abfm.batch.kinds import KINDS
from abfm.errors import ResultError, brief, one_line
from abfm.io import results
from abfm.matching.problem import load_problem
from abfm.population.task import PopulationTask
from abfm.registration.files import load_correspondence
from abfm.tasks.task import Task

_TASKS: tuple[type[Task], ...] = (PopulationTask, *KINDS.values())


def load(path: str | os.PathLike[str], *expected: type) -> Any:
    """Read a result or a problem from its file.

    Parameters
    ----------
    path : path
        A file that `save` wrote, or the folder of a population.
    *expected : type
        Types that are accepted; by default all.

    Returns
    -------
    Match, Registration, Correspondence, Sequence, Population or Problem
        What the file holds. Values that do not fit the field of a match are recomputed, and
        ``match.doubt`` reports it.

    Raises
    ------
    ResultError
        If the file is missing or damaged, or holds none of these.
    """
    found = _loaded(path)
    if expected and not isinstance(found, expected):
        names = " or ".join(each.__name__ for each in expected)
        kind = type(found).__name__
        raise ResultError(
            f"{one_line(path)} holds a {kind}; expected a {names} (`abfm info` describes it)"
        )
    return found


def _loaded(path: str | os.PathLike[str]) -> Any:
    if Path(path).is_dir():
        return PopulationTask.file.load(path)
    with results.open_archive(Path(path), results.RESULT.name, results.MEND) as archive:
        names = set(archive)
    fitting = [task for task in _TASKS if task.file.marks <= names]
    if fitting:
        return max(fitting, key=lambda task: len(task.file.marks)).file.load(path)
    if "a_vertices" in names:
        return load_correspondence(path)
    if {"source", "target"} <= names:
        return load_problem(path)
    raise ResultError(
        f"{one_line(path)} holds no result or problem of abfm; expected a file that save() wrote"
    )


def task_of(found: Any) -> type[Task]:
    """Return the kind of task that a result is of."""
    for task in _TASKS:
        if type(found) is task.result:
            return task
    raise ResultError(f"{brief(found)} is not the result of a task")

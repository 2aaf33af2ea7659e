"""Results of all kinds: read from files, and the tasks that they are results of."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from abfm.errors import ResultError, brief, one_line
from abfm.io import results
from abfm.matching.problem import load_problem
from abfm.matching.task import MatchTask
from abfm.population.task import PopulationTask
from abfm.registration.files import load_correspondence
from abfm.registration.task import RegistrationTask
from abfm.sequences.task import SequenceTask
from abfm.tasks.task import Task

_TASKS = (MatchTask, RegistrationTask, SequenceTask, PopulationTask)
_LOADERS = (
    ({"subject_weights", "template_mask"}, PopulationTask.load),
    ({"frames", "velocity"}, SequenceTask.load),
    ({"a_vertices"}, load_correspondence),  # also of registrations
    ({"velocity"}, MatchTask.load),
    ({"source", "target"}, load_problem),
)
"""The function that reads a file with such arrays, the first that fits."""


def load(path: str | os.PathLike[str]) -> Any:
    """Read a result or a problem from its file.

    Parameters
    ----------
    path : path
        A file that `save` wrote, or the folder of a population.

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
    if Path(path).is_dir():
        return PopulationTask.load(path)
    with results.open_archive(Path(path), results.RESULT.name, results.MEND) as archive:
        names = set(archive)
    for arrays, read in _LOADERS:
        if arrays <= names:
            return read(path)
    raise ResultError(
        f"{one_line(path)} holds no result or problem of abfm; expected a file that save() wrote"
    )


def task_of(found: Any) -> type[Task]:
    """Return the kind of task that a result is of."""
    for task in _TASKS:
        if isinstance(found, task.result):
            return task
    raise ResultError(f"{brief(found)} is not the result of a task")

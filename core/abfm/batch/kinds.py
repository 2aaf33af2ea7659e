"""Types of tasks that the rows of a table may have."""

from __future__ import annotations

from collections.abc import Mapping

from abfm.errors import ColumnError, ParameterError, brief
from abfm.matching.task import MatchTask, ProblemTask
from abfm.registration.symmetric import SymmetricTask
from abfm.registration.task import RegistrationTask
from abfm.sequences.task import SequenceTask
from abfm.tasks.inputs import Input
from abfm.tasks.task import Task

KINDS: Mapping[str, type[Task]] = {
    task.kind: task
    for task in (SequenceTask, MatchTask, RegistrationTask, SymmetricTask, ProblemTask)
}
"""Types of tasks by the name of their kind. A row that does not name its kind has the first type
whose first required column is filled.
"""


TASK = Input(name="task", help="the kind of task, if it does not follow from the other columns")


def kind_of(given: Mapping[str, str]) -> type[Task]:
    """Return the type of task of a row, given its texts by column, or raise a ParameterError."""
    if (name := given.get(TASK.name)) is not None:
        if name not in KINDS:
            raise ColumnError(TASK.name, f": {brief(name)} is not one of {', '.join(KINDS)}")
        return KINDS[name]
    for task in KINDS.values():
        if task.needs[0] in given:
            return task
    choices = ", or ".join(f"{' and '.join(task.needs)} ({task.kind})" for task in KINDS.values())
    raise ParameterError(f"the kind of task is unknown; fill the columns {choices}")

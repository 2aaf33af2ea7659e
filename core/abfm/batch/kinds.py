"""The kinds of tasks that rows of a table may have."""

from __future__ import annotations

from collections.abc import Mapping

from abfm.errors import ParameterError, brief
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
"""Tasks by the name of their kind. Unless it is named, a row is of the first whose first needed
column it fills.
"""


TASK = Input(name="task", help="the kind of task, if the other columns do not tell")


def kind_of(given: Mapping[str, str]) -> type[Task]:
    """Return the kind of task of a row by its texts by column, or raise a ParameterError."""
    if (name := given.get(TASK.name)) is not None:
        if name not in KINDS:
            raise ParameterError(f"column task: {brief(name)} is not one of {', '.join(KINDS)}")
        return KINDS[name]
    for task in KINDS.values():
        if task.needs[0] in given:
            return task
    choices = ", or ".join(f"{' and '.join(task.needs)} ({task.kind})" for task in KINDS.values())
    raise ParameterError(f"it is of no kind: fill {choices}")

"""What a worker does with a row: wherever it runs, whatever it sees of the file system."""

from __future__ import annotations

import dataclasses
import os
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, Self

from abfm.batch.ledger import Ledger, Record
from abfm.batch.rows import Row, own_version
from abfm.errors import AbfmError, AbfmWarning, ResultError, one_line
from abfm.flow.exponential import counted_row_products
from abfm.io import temporary_folder
from abfm.matching.solving.record import Iteration
from abfm.outcome import Outcome
from abfm.sequences import remove_checkpoints
from abfm.tasks.monitor import Monitor, ignore
from abfm.tasks.task import Task as Solvable
from abfm.workers.control import CancelledError, Control, checkpoint, current_control
from abfm.workers.progress import step

IMPOSSIBLE_STEP = f"{Outcome.IMPOSSIBLE}: "
"""Begin of the step of a row that no flow can match."""


class Computation(Protocol):
    """Something to compute from files whose result goes back as a value, and into no folder."""

    def files(self) -> list[str]:
        """Return the absolute names of the files that it reads, whether they exist or not."""

    def moved(self, places: Mapping[str, str]) -> Self:
        """Return the same with files, by their absolute names, elsewhere."""

    def computed(self) -> object:
        """Return the result."""


@dataclass(frozen=True)
class Task:
    """A row to solve, and the folder for its result, known by what is in it; or a computation."""

    row: Row | Computation
    folder: str = ""
    identity: str = ""
    contents: Mapping[str, bytes] | None = None  # of files, where the worker does not see them
    version: str = field(default_factory=own_version)  # of abfm, where it is asked for
    tries: int = 1  # with this one; others ended with their process
    number: int = 0  # among those that are solved


@dataclass(frozen=True)
class Answer:
    """What came of a task."""

    record: Record = Record()
    result: bytes | None = None  # of the file, where the folder is not seen
    value: Any = None  # of a computation
    is_blind: bool = False  # files are not seen: the task is to be sent again, with their contents


@dataclass
class Cost:
    """The cost of a match, measured while it is solved; None is unknown."""

    evaluations: int | None = None  # of energy and gradient, up to the last iterate
    seconds_to_goal: float | None = None  # until the residual on the mesh itself was the goal

    def watch(self, goal: float | None) -> Callable[[Iteration], object]:
        """Return a function to call after every iteration of a match with a goal; None for tasks
        that have none.
        """
        if goal is None:
            return ignore
        began = time.monotonic()

        def measure(now: Iteration) -> None:
            self.evaluations = now.evaluations
            is_reached = now.level == now.levels - 1 and now.residual <= goal
            if is_reached and self.seconds_to_goal is None:
                self.seconds_to_goal = time.monotonic() - began

        return measure


def attempt(task: Task) -> Answer:
    """Solve a row and write its result, if nobody has; a failure is an answer, not an error.

    Where the folder is seen, what is known of the row is written there, too. `CancelledError` is
    raised where this thread's control was cancelled meanwhile.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", AbfmWarning)
        answer = _answer(task)
    texts = [str(each.message) for each in caught if issubclass(each.category, AbfmWarning)]
    record = replace(answer.record, tries=task.tries, warning="; ".join(texts))
    answer = replace(answer, record=record)
    if isinstance(task.row, Row) and not answer.is_blind and answer.result is None:
        ledger = Ledger(task.folder)
        if ledger.is_seen(task.identity):
            ledger.record(task.row, answer.record)
    return answer


def _answer(task: Task) -> Answer:
    if task.version != (there := own_version()):
        reason = f"its worker has abfm {there}; install abfm {task.version} there, as it is here"
        return Answer(Record(reason=reason))
    if task.contents is None and not all(map(os.path.exists, task.row.files())):
        return Answer(is_blind=True)
    digest = ""
    try:
        with ExitStack() as opened:
            row = task.row
            if task.contents:
                folder = temporary_folder()
                row = _with_contents(row, task.contents, opened.enter_context(folder))
            if not isinstance(row, Row):
                return Answer(value=row.computed())
            prepared = row.task()
            digest = prepared.digest
            return _solved(task, row, prepared)
    except CancelledError:
        raise
    except AbfmError as error:
        checkpoint()  # what was cancelled before there was anything has not failed
        return Answer(Record(digest, str(error) or "it was refused"))
    except MemoryError:
        return Answer(Record(digest, "out of memory"))
    # a library's own error, or a bug: others go on
    except Exception as error:
        return Answer(Record(digest, f"{type(error).__name__}: {one_line(error)}"))


def _solved(task: Task, row: Row, prepared: Solvable) -> Answer:
    """Have the result in the folder; its bytes where that is not seen."""
    ledger = Ledger(task.folder)
    if ledger.is_seen(task.identity):
        path = ledger.result(prepared.digest)
        if ledger.has(prepared.digest):
            remove_checkpoints(path)
            entry = ledger.entry(row)  # of this run, if its answer was lost with a worker of Dask
            return Answer(entry.record if entry.state == "done" else Record(prepared.digest))
        return Answer(_save(task, row, prepared, path))
    with temporary_folder() as folder:
        path = folder / "result.npz"
        return Answer(_save(task, row, prepared, path), path.read_bytes())


def _save(task: Task, row: Row, prepared: Solvable, path: Path) -> Record:
    """Solve, write the result, and return what it took."""
    control, cost, began = current_control() or Control(), Cost(), time.monotonic()
    _report_expected(task, row, prepared)
    with counted_row_products() as products:
        monitor = Monitor(control, cost.watch(prepared.goal), checkpoint=path)
        found = prepared.solve(monitor)
    if control.cancelled:
        raise CancelledError
    if (
        task.contents is None
        and type(row)(row.name, row.options, row.folder, row.declared).key != row.key
    ):
        raise ResultError("a file of it changed while it was solved; run the same again")
    found.save(path)
    remove_checkpoints(path)
    seconds = time.monotonic() - began
    count = None if products.is_shared else products.count  # unknown in a worker of several threads
    return Record(prepared.digest, seconds=seconds, row_products=count, **dataclasses.asdict(cost))


def _report_expected(task: Task, row: Row, prepared: Solvable) -> None:
    """Report a row that no flow can match before it is solved, which may take long: as a step, and
    in the ledger.
    """
    facts, ledger = prepared.expected(), Ledger(task.folder)
    if facts is None or facts.outcome is not Outcome.IMPOSSIBLE:
        return
    if ledger.is_seen(task.identity):
        expected = f"{facts.outcome}: {facts.reason}"
        ledger.record(row, Record(prepared.digest, expected=expected))
    with step(f"{IMPOSSIBLE_STEP}{one_line(row.name, 80)}: {facts.reason}"):
        pass


def _with_contents(
    row: Row | Computation, contents: Mapping[str, bytes], folder: Path
) -> Row | Computation:
    """Return the row with files in a folder, each where it is from the others."""
    places = dict[str, str]()
    for path, content in contents.items():
        place = folder / Path(os.path.normpath(path)).relative_to(Path(path).anchor)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
        places[path] = os.fspath(place)
    return row.moved(places)

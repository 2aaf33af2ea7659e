"""Solution of one row by a worker, with or without access to the folders of the batch."""

from __future__ import annotations

import dataclasses
import os
import re
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, Self

from abfm.batch.ledger import Ledger, Record
from abfm.batch.rows import Row, installed_version
from abfm.errors import AbfmError, AbfmWarning, ResultError, one_line
from abfm.flow.exponential import counted_row_products
from abfm.io import temporary_folder
from abfm.matching.solving.record import Iteration
from abfm.outcome import Outcome
from abfm.sequences import remove_checkpoints
from abfm.tasks.monitor import Monitor, ignore
from abfm.tasks.task import Task
from abfm.workers.control import CancelledError, Control, checkpoint, current_control
from abfm.workers.progress import step

IMPOSSIBLE_STEP = f"{Outcome.IMPOSSIBLE}: "
"""Prefix of the progress step that reports a row whose functions no flow can match."""


class Computation(Protocol):
    """A computation that reads files and returns a value; unlike a row, it writes no result."""

    def files(self) -> list[str]:
        """Return the absolute names of all files to be read, whether they exist or not."""

    def relocated(self, places: Mapping[str, str]) -> Self: ...

    def compute(self) -> object: ...


@dataclass(frozen=True)
class WorkItem:
    """A job for a worker: a row to solve with the folder for its result, or a computation.

    A worker recognises the folder by the text in the folder's file ``identity``.
    """

    row: Row | Computation
    folder: str = ""
    identity: str = ""  # content of that file
    # contents of the row's files by name, if the worker has no access to them
    contents: Mapping[str, bytes] | None = None
    version: str = field(default_factory=installed_version)  # version of abfm that created the item
    tries: int = 1  # number of this attempt; in earlier ones the process died
    number: int = 0  # index in the list of items


@dataclass(frozen=True)
class Answer:
    """A worker's answer to a work item: the record of a row, or the value of a computation."""

    record: Record = Record()
    result: bytes | None = None  # content of the result file, if the folder is not accessible
    value: Any = None  # result of a computation
    needs_contents: bool = False  # files are not accessible; send their contents with the item


@dataclass
class Cost:
    """Cost of a match, measured while it is solved; None if unknown."""

    evaluations: int | None = None  # evaluations of energy and gradient until the last iterate
    seconds_to_goal: float | None = None  # until the residual on the input mesh reached the goal

    def watch(self, goal: float | None) -> Callable[[Iteration], object]:
        """Return a function that updates the cost; call it after every iteration of a match.

        ``goal`` is the goal of the match. If it is None, the function does nothing.
        """
        if goal is None:
            return ignore
        began = time.monotonic()

        def measure(now: Iteration) -> None:
            self.evaluations = now.evaluations
            reached_goal = now.level == now.levels - 1 and now.residual <= goal
            if reached_goal and self.seconds_to_goal is None:
                self.seconds_to_goal = time.monotonic() - began

        return measure


def attempt(item: WorkItem) -> Answer:
    """Solve a work item; write its result, unless it exists, and return failures as answers.

    The row's record is also written if the folder is accessible from this machine. Raises
    CancelledError if the control of this thread was cancelled.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", AbfmWarning)
        answer = _answer(item)
    texts = [str(each.message) for each in caught if issubclass(each.category, AbfmWarning)]
    record = replace(answer.record, tries=item.tries, warning="; ".join(texts))
    answer = replace(answer, record=record)
    if isinstance(item.row, Row) and not answer.needs_contents and answer.result is None:
        ledger = Ledger(item.folder)
        if ledger.is_accessible(item.identity):
            ledger.record(item.row, answer.record)
    return answer


def _answer(item: WorkItem) -> Answer:
    if item.version != (there := installed_version()):
        reason = (
            f"the worker has abfm {there}, but the batch was started by abfm {item.version}; "
            "install the same version for the worker"
        )
        return Answer(Record(reason=reason))
    if item.contents is None and not all(map(os.path.exists, item.row.files())):
        return Answer(needs_contents=True)
    digest = ""
    try:
        with ExitStack() as opened:
            row = item.row
            if item.contents:
                folder = opened.enter_context(temporary_folder())
                row = _with_contents(row, item.contents, folder)
            if not isinstance(row, Row):
                return Answer(value=row.compute())
            prepared = row.task()
            digest = prepared.digest
            return _solved(item, row, prepared)
    except CancelledError:
        raise
    except AbfmError as error:
        checkpoint()  # a task cancelled before it started is not a failure
        return Answer(Record(digest, str(error) or "the row is invalid"))
    except MemoryError:
        return Answer(Record(digest, "out of memory"))
    # an error of a library or a bug must not stop the other rows
    except Exception as error:
        return Answer(Record(digest, f"{type(error).__name__}: {one_line(error)}"))


def _solved(item: WorkItem, row: Row, prepared: Task) -> Answer:
    """Solve a row; write its result to the folder, or return its bytes if this is impossible."""
    ledger = Ledger(item.folder)
    if ledger.is_accessible(item.identity):
        path = ledger.result_path(prepared.digest)
        if ledger.has_result(prepared.digest):
            remove_checkpoints(path)
            entry = ledger.entry(row)  # this run wrote it if a Dask worker died before it answered
            return Answer(entry.record if entry.state == "done" else Record(prepared.digest))
        return Answer(_save(item, row, prepared, path))
    with temporary_folder() as folder:
        path = folder / "result.npz"
        return Answer(_save(item, row, prepared, path), path.read_bytes())


def _save(item: WorkItem, row: Row, prepared: Task, path: Path) -> Record:
    control, cost, began = current_control() or Control(), Cost(), time.monotonic()
    _report_expected(item, row, prepared)
    with counted_row_products() as products:
        monitor = Monitor(control, cost.watch(prepared.goal), checkpoint=path)
        found = prepared.solve(monitor)
    if control.cancelled:
        raise CancelledError
    if (
        item.contents is None
        and type(row)(row.name, row.options, row.folder, row.task_type).key != row.key
    ):
        raise ResultError(
            "an input file changed while the row was solved; run the same command again"
        )
    found.save(path)
    remove_checkpoints(path)
    seconds = time.monotonic() - began
    # unknown if several threads of the worker share the count
    count = None if products.is_shared else products.count
    return Record(prepared.digest, seconds=seconds, row_products=count, **dataclasses.asdict(cost))


def _report_expected(item: WorkItem, row: Row, prepared: Task) -> None:
    """Report a row whose functions no flow can match, by a progress step and a record."""
    facts, ledger = prepared.expected(), Ledger(item.folder)
    if facts is None or facts.outcome is not Outcome.IMPOSSIBLE:
        return
    if ledger.is_accessible(item.identity):
        expected = f"{facts.outcome}: {facts.reason}"
        ledger.record(row, Record(prepared.digest, expected=expected))
    with step(f"{IMPOSSIBLE_STEP}{one_line(row.name, 80)}: {facts.reason}"):
        pass


def _with_contents(
    row: Row | Computation, contents: Mapping[str, bytes], folder: Path
) -> Row | Computation:
    """Write files, given as contents by path, to a folder; return the row with their new paths."""
    places = dict[str, str]()
    for path, content in contents.items():
        drive, relative = os.path.splitdrive(os.path.normpath(path))
        # files of several drives or shares of Windows must not replace each other
        place = Path(folder, re.sub(r"\W", "_", drive), relative.lstrip(os.sep))
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
        places[path] = os.fspath(place)
    return row.relocated(places)

"""Solve many rows by processes of this machine or by a cluster elsewhere."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import CancelledError as FutureCancelledError
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace

from abfm.batch.attempt import IMPOSSIBLE_STEP, Answer, Computation, Task, attempt
from abfm.batch.cluster import CONNECTING, NO_WORKERS, Cluster, LostError
from abfm.batch.ledger import Ledger, LedgerEntry, Record
from abfm.batch.on_dask import OnDask
from abfm.batch.rows import Row
from abfm.errors import AbfmWarning, one_line
from abfm.reading import read_bytes
from abfm.workers.control import CancelledError, Control
from abfm.workers.executor import CALLS_SUBMITTED_MAX, Processes, completed, in_order
from abfm.workers.worker import WorkerEndedError

TRIES = 3
"""How often a row is tried whose process dies."""
ENDED_MESSAGE = f"the process that solved it ended {TRIES} times, as for want of memory"
ROWS_READ_MIN = 500
"""Rows whose entries are read also if the run is cancelled before; of more that takes long."""
VALUES_SUBMITTED_MAX = 256
"""Computations that are submitted at once: their results are in memory until they are taken."""
REPORTED_STEPS = (CONNECTING, NO_WORKERS, IMPOSSIBLE_STEP)
"""Beginnings of the steps that a user sees while rows are solved, see `abfm.workers.progress`."""


def run(
    rows: Iterable[Row],
    folder: str | os.PathLike[str],
    cluster: Cluster | None = None,
    *,
    on_change: Callable[[LedgerEntry], object] = lambda entry: None,
    control: Control | None = None,
) -> list[LedgerEntry]:
    """Solve rows that have no result in a folder yet, and return what has come of all, in order.

    Each result is ``<digest>.npz`` in the folder, and is the same, bit for bit, whoever solves it
    on machines of one kind. Rows that fail are told with their reason and do not stop others; the
    next run tries them again. Whatever is killed, also this process, leaves whole files, and the
    next run goes on: what is lost are rows under way.

    Parameters
    ----------
    rows : iterable of Row
        Equal ones are solved once.
    folder : path
        It is made if it is not there.
    cluster : Cluster, optional
        By default this machine's cores.
    on_change : callable
        Called in this thread with each entry that is new, as it comes.
    control : Control, optional
        To end before all is done: rows under way are given up, and are missing then.

    Raises
    ------
    AbfmError
        If the folder cannot be written to, or there is no such cluster.
    """
    with Workers(cluster) as workers:
        return workers.run(rows, folder, on_change=on_change, control=control)


class Workers:
    """Who solves rows, to be used in a ``with``: processes, or a connection to a cluster, that are
    started when there is first something to solve and kept from one `run` to the next.

    Parameters
    ----------
    cluster : Cluster, optional
        By default this machine's cores.
    """

    def __init__(self, cluster: Cluster | None = None) -> None:
        self.cluster = cluster or Cluster()
        self._processes: Processes | None = None
        self._dask: OnDask | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes at once, or close the connection; the next run starts others."""
        if self._processes is not None:
            self._processes.shutdown(cancel_futures=True)
        if self._dask is not None:
            self._dask.close()
        self._processes = self._dask = None

    def run(
        self,
        rows: Iterable[Row],
        folder: str | os.PathLike[str],
        *,
        on_change: Callable[[LedgerEntry], object] = lambda entry: None,
        control: Control | None = None,
    ) -> list[LedgerEntry]:
        """Solve rows that have no result in a folder yet, see `abfm.batch.run`."""
        rows, control, ledger = list(rows), control or Control(), Ledger(folder)
        identity = ledger.make()
        entries, tasks, warned = dict[str, LedgerEntry](), deque[Task](), set[str]()
        for number, row in enumerate(rows):
            if control.cancelled and len(entries) >= ROWS_READ_MIN:
                break
            if row.key in entries:
                continue
            entries[row.key] = ledger.entry(row)
            if entries[row.key].state != "done" and not control.cancelled:
                ledger.forget(row)
                entries[row.key] = LedgerEntry(row, "missing")
                tasks.append(Task(row, os.fspath(ledger.folder), identity, number=number))
        if not control.cancelled and tasks:
            with closing(self._answers(tasks, control)) as answers:
                for task, answer in answers:
                    if answer.result is not None:
                        ledger.write_result(answer.record.digest, answer.result)
                    row = rows[task.number]
                    entry = entries[row.key] = ledger.record(row, answer.record)
                    text = entry.record.warning
                    if text and text not in warned:  # of the first row that has it
                        warned.add(text)
                        message = f"row {one_line(entry.row.name)}: {text}"
                        warnings.warn(message, AbfmWarning, stacklevel=2)
                    on_change(entry)
        if control.cancelled:  # workers have ended, perhaps while they wrote
            ledger.remove_abandoned()
        # not read from the folder again, which takes long for many rows
        return [
            replace(entries[row.key], row=row)
            if row.key in entries
            else LedgerEntry(row, "missing")
            for row in rows
        ]

    def compute(
        self, computations: Iterable[Computation], control: Control | None = None
    ) -> Generator[Answer, None, None]:
        """Yield what comes of each computation, in their order, until it is cancelled."""
        tasks = deque(Task(each, number=number) for number, each in enumerate(computations))
        with closing(self._answers(tasks, control or Control(), VALUES_SUBMITTED_MAX)) as answers:
            yield from in_order((task.number, answer) for task, answer in answers)

    def _answers(
        self, tasks: deque[Task], control: Control, most: int = CALLS_SUBMITTED_MAX
    ) -> Generator[tuple[Task, Answer], None, None]:
        """Yield each task with what came of it, as it comes, until no more are wanted."""
        missing = len(tasks)

        def is_wanted() -> bool:
            if not is_alive():
                raise FutureCancelledError
            return not control.cancelled

        try:
            executor, watched = self._executor(control)
            with watched as is_alive:
                for task, future in completed(
                    lambda task: executor.submit(attempt, task), tasks, is_wanted, most
                ):
                    found = _found(task, future)
                    if isinstance(found, Task):
                        tasks.appendleft(found)
                    else:
                        missing -= 1
                        yield task, found
        except FutureCancelledError as error:
            raise LostError(
                f"the scheduler does not answer any more; {missing} rows are left: run the same "
                "again to go on"
            ) from error
        except CancelledError:  # while it was connecting
            pass
        finally:
            if missing:
                self.close()  # rows under way would go on before those of the next run

    def _executor(
        self, control: Control
    ) -> tuple[Executor, AbstractContextManager[Callable[[], bool]]]:
        """Return an executor, and what yields a function that returns whether it is alive."""
        if self.cluster.is_local:
            if self._processes is None:
                self._processes = Processes(self.cluster.processes)
            return self._processes, nullcontext(lambda: True)
        if self._dask is None or not self._dask.is_alive:
            self.close()
            self._dask = OnDask(self.cluster, control)
        return self._dask.executor, self._dask.watched()


def _found(task: Task, future: Future[Answer]) -> Answer | Task:
    """Return what came of a task, or the task that is to be submitted next."""
    try:
        answer = future.result()
    except WorkerEndedError:
        if task.tries < TRIES:
            return replace(task, tries=task.tries + 1)
        return Answer(Record(reason=ENDED_MESSAGE, tries=TRIES))
    except FutureCancelledError:
        raise
    except Exception as error:  # a bug, or what Dask reports of workers that died
        return Answer(Record(reason=f"{type(error).__name__}: {one_line(error)}"))
    return seen_here(task) if answer.is_blind else answer


def seen_here(task: Task) -> Task:
    """Return a task with the contents of its files, as far as they are seen here."""
    contents = {}
    for path in task.row.files():
        try:
            contents[path] = read_bytes(path)
        except OSError:
            continue  # the row tells itself that it is missing
    return replace(task, contents=contents)

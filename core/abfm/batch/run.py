"""Solution of many rows by processes of this machine or by a cluster."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import CancelledError as FutureCancelledError
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace

from abfm.batch.attempt import IMPOSSIBLE_STEP, Answer, Computation, WorkItem, attempt
from abfm.batch.cluster import CONNECTING, NO_WORKERS, Cluster, ConnectionLostError
from abfm.batch.dask_connection import DaskConnection
from abfm.batch.ledger import Ledger, LedgerEntry, Record
from abfm.batch.rows import Row
from abfm.errors import AbfmWarning, one_line
from abfm.reading import read_bytes
from abfm.wording import counted
from abfm.workers.control import CancelledError, Control
from abfm.workers.executor import CALLS_SUBMITTED_MAX, Processes, completed, in_order
from abfm.workers.worker import WorkerEndedError

TRIES = 3  # maximum number of attempts to solve a row whose process dies
ENDED_MESSAGE = f"its process ended {TRIES} times, possibly because of too little memory"
ROWS_READ_MIN = 500
"""Number of rows whose entries are read even if the run is already cancelled. Others are then
reported as missing, because reading the entries of many rows takes long.
"""
VALUES_SUBMITTED_MAX = 256
"""Number of computations that are submitted at once. Their results stay in memory until the caller
consumes them.
"""
REPORTED_STEPS = (CONNECTING, NO_WORKERS, IMPOSSIBLE_STEP)
"""Prefixes of the steps that the user sees while rows are solved, see `abfm.workers.progress`."""


def run(
    rows: Iterable[Row],
    folder: str | os.PathLike[str],
    cluster: Cluster | None = None,
    *,
    on_change: Callable[[LedgerEntry], object] = lambda entry: None,
    control: Control | None = None,
) -> list[LedgerEntry]:
    """Solve all rows that have no result in a folder yet; return the entries of all rows in order.

    Each result is a file ``<digest>.npz`` in the folder. Machines of the same type produce the same
    bits, with any choice of workers. If a row fails, its entry reports the cause, other rows
    continue, and the next run attempts it again. If any process is killed, including this one,
    files stay complete and the next run resumes. Only rows in progress are lost.

    Parameters
    ----------
    rows : iterable of Row
        Rows to solve; equal rows are solved once.
    folder : path
        Folder of the results, created if it does not exist.
    cluster : Cluster, optional
        Workers that solve the rows; by default the cores of this machine.
    on_change : callable
        Function that is called, in this thread, with each new ledger entry.
    control : Control, optional
        Object that cancels the run. Rows in progress are then abandoned and reported as missing.

    Raises
    ------
    AbfmError
        If the folder is not writable, or the cluster is not available.
    """
    with Workers(cluster) as workers:
        return workers.run(rows, folder, on_change=on_change, control=control)


class Workers:
    """Context manager of workers that are shared by several runs.

    The processes, or the connection to a cluster, start when the first row has to be solved. They
    persist until `close`.

    Parameters
    ----------
    cluster : Cluster, optional
        Workers that solve the rows; by default the cores of this machine.
    """

    def __init__(self, cluster: Cluster | None = None) -> None:
        self.cluster = cluster or Cluster()
        self._processes: Processes | None = None
        self._connection: DaskConnection | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes at once, or close the connection; the next run starts new ones."""
        if self._processes is not None:
            self._processes.shutdown(cancel_futures=True)
        if self._connection is not None:
            self._connection.close()
        self._processes = self._connection = None

    def run(
        self,
        rows: Iterable[Row],
        folder: str | os.PathLike[str],
        *,
        on_change: Callable[[LedgerEntry], object] = lambda entry: None,
        control: Control | None = None,
    ) -> list[LedgerEntry]:
        """Solve all rows that have no result in a folder yet, see `abfm.batch.run`."""
        rows, control, ledger = list(rows), control or Control(), Ledger(folder)
        identity = ledger.make()
        entries, items, warned = dict[str, LedgerEntry](), deque[WorkItem](), set[str]()
        for number, row in enumerate(rows):
            if control.cancelled and len(entries) >= ROWS_READ_MIN:
                break
            if row.key in entries:
                continue
            entries[row.key] = ledger.entry(row)
            if entries[row.key].state != "done" and not control.cancelled:
                ledger.forget(row)
                entries[row.key] = LedgerEntry(row, "missing")
                items.append(WorkItem(row, os.fspath(ledger.folder), identity, number=number))
        if not control.cancelled and items:
            with closing(self._answers(items, control)) as answers:
                for item, answer in answers:
                    if answer.result is not None:
                        ledger.write_result(answer.record.digest, answer.result)
                    row = rows[item.number]
                    entry = entries[row.key] = ledger.record(row, answer.record)
                    text = entry.record.warning
                    if text and text not in warned:  # warn only for the first row with this text
                        warned.add(text)
                        message = f"row {one_line(entry.row.name)}: {text}"
                        warnings.warn(message, AbfmWarning, stacklevel=2)
                    on_change(entry)
        if control.cancelled:  # workers may have ended while they were writing
            ledger.remove_abandoned()
        # the entries are not read again, which takes long for many rows
        return [
            replace(entries.get(row.key) or LedgerEntry(row, "missing"), row=row) for row in rows
        ]

    def compute(
        self, computations: Iterable[Computation], control: Control | None = None
    ) -> Generator[Answer, None, None]:
        """Yield the answer of each computation in order, until cancelled."""
        items = deque(WorkItem(each, number=number) for number, each in enumerate(computations))
        with closing(self._answers(items, control or Control(), VALUES_SUBMITTED_MAX)) as answers:
            yield from in_order((item.number, answer) for item, answer in answers)

    def _answers(
        self, items: deque[WorkItem], control: Control, submitted_max: int = CALLS_SUBMITTED_MAX
    ) -> Generator[tuple[WorkItem, Answer], None, None]:
        """Yield each item with its answer, in the order in which they finish, until cancelled."""
        unfinished = len(items)

        def is_wanted() -> bool:
            if not is_alive():
                raise FutureCancelledError
            return not control.cancelled

        try:
            executor, watched = self._executor(control)
            with watched as is_alive:
                for item, future in completed(
                    lambda item: executor.submit(attempt, item), items, is_wanted, submitted_max
                ):
                    found = _answer_or_retry(item, future)
                    if isinstance(found, WorkItem):
                        items.appendleft(found)
                    else:
                        unfinished -= 1
                        yield item, found
        except FutureCancelledError as error:
            raise ConnectionLostError(
                f"the scheduler no longer answers; {counted(unfinished, 'row is', 'rows are')} "
                "unfinished. Run the same command again to resume"
            ) from error
        except CancelledError:  # the run was cancelled while connecting
            pass
        finally:
            if unfinished:
                self.close()  # otherwise rows in progress would delay the next run

    def _executor(
        self, control: Control
    ) -> tuple[Executor, AbstractContextManager[Callable[[], bool]]]:
        """Return an executor and a context manager.

        The latter yields a function that returns whether the workers are reachable.
        """
        if self.cluster.scheduler is None and self.cluster.scheduler_file is None:
            if self._processes is None:
                self._processes = Processes(self.cluster.processes)
            return self._processes, nullcontext(lambda: True)
        if self._connection is None or not self._connection.is_alive:
            self.close()
            self._connection = DaskConnection(self.cluster, control)
        return self._connection.executor, self._connection.watched()


def _answer_or_retry(item: WorkItem, future: Future[Answer]) -> Answer | WorkItem:
    try:
        answer = future.result()
    except WorkerEndedError:
        if item.tries < TRIES:
            return replace(item, tries=item.tries + 1)
        return Answer(Record(reason=ENDED_MESSAGE, tries=TRIES))
    except FutureCancelledError:
        raise
    except Exception as error:  # a bug, or a report of Dask about dead workers
        return Answer(Record(reason=f"{type(error).__name__}: {one_line(error)}"))
    return with_contents(item) if answer.needs_contents else answer


def with_contents(item: WorkItem) -> WorkItem:
    """Return an item with the readable contents of its files, for a worker without access."""
    contents = {}
    for path in item.row.files():
        try:
            contents[path] = read_bytes(path)
        except OSError:
            continue  # the row reports the missing file
    return replace(item, contents=contents)

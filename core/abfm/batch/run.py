"""Many rows, by one process, by a cluster of this machine's cores, or by a cluster elsewhere."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from abfm.batch.attempt import EXPECTED, Answer, Task, attempt
from abfm.batch.ledger import Entry, Ledger, Record
from abfm.batch.rows import Row
from abfm.errors import AbfmWarning, ParameterError, ResultError, brief, one_line
from abfm.reading import read_bytes
from abfm.workers.control import Control
from abfm.workers.worker import Worker, WorkerEndedError, stateless

if TYPE_CHECKING:
    from abfm.batch.on_dask import OnDask

ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS", "NUMBA", "VECLIB_MAXIMUM")
}
"""What makes compiled libraries compute in one thread: a row takes one core, and sums of several
threads come out differently.
"""
TRIES = 3
"""How often a row is tried whose worker dies."""
ENDED = f"the process that solved it ended {TRIES} times, as for want of memory"
ROWS_READ_MIN = 500
"""Rows whose entries are read also if the run is cancelled before; of more that takes long."""
CONNECTING = "connecting to the scheduler"
NO_WORKERS = "waiting for workers: the cluster has none"
REPORTED_STEPS = (CONNECTING, NO_WORKERS, EXPECTED)
"""Beginnings of the steps that a user sees while rows are solved, see `abfm.workers.progress`."""


class LostError(ResultError):
    """Who solved the rows is gone; what is done is kept."""


@dataclass(frozen=True)
class Cluster:
    """Who solves the rows.

    Parameters
    ----------
    jobs : int, optional
        So many processes of this machine; by default one for each core that this process may use.
        More than one need ``dask.distributed``, the extra ``cluster``.
    scheduler : str, optional
        Instead of these, the address of the scheduler of a Dask cluster, such as
        ``tcp://10.0.0.1:8786``; or
    scheduler_file : path, optional
        the file in which the scheduler has its address.

    Raises
    ------
    ParameterError
        If more than one of them is given, or a number that is none of processes.
    """

    jobs: int | None = None
    scheduler: str | None = None
    scheduler_file: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        given = [each for each in (self.jobs, self.scheduler, self.scheduler_file) if each]
        if len(given) > 1:
            raise ParameterError("give one of jobs, scheduler and scheduler_file, or none")
        if self.jobs is not None and not (isinstance(self.jobs, int) and 1 <= self.jobs <= 4096):
            raise ParameterError(
                f"jobs is {brief(self.jobs)}; expected a number of processes, 1 to 4096"
            )

    @property
    def is_local(self) -> bool:
        """Whether the processes are this machine's, and started for the run."""
        return self.scheduler is None and self.scheduler_file is None

    @property
    def processes(self) -> int:
        """How many there are, where they are this machine's."""
        return self.jobs or cores()


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run(
    rows: Iterable[Row],
    folder: str | os.PathLike[str],
    cluster: Cluster | None = None,
    *,
    on_change: Callable[[Entry], object] = lambda entry: None,
    control: Control | None = None,
) -> list[Entry]:
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
    """Who solves rows, to be used in a ``with``: its processes are started when there is first
    something to solve, and kept from one `run` to the next.

    Parameters
    ----------
    cluster : Cluster, optional
        By default this machine's cores.
    """

    def __init__(self, cluster: Cluster | None = None) -> None:
        self.cluster, self._open = cluster or Cluster(), ExitStack()
        self._one: Worker[None] | None = None
        self._dask: OnDask | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def run(
        self,
        rows: Iterable[Row],
        folder: str | os.PathLike[str],
        *,
        on_change: Callable[[Entry], object] = lambda entry: None,
        control: Control | None = None,
    ) -> list[Entry]:
        """Solve rows that have no result in a folder yet, see `abfm.batch.run`."""
        rows, control, ledger = list(rows), control or Control(), Ledger(folder)
        identity = ledger.make()
        entries, tasks = dict[str, Entry](), list[Task]()
        for row in rows:
            if control.cancelled and len(entries) >= ROWS_READ_MIN:
                break
            if row.key in entries:
                continue
            entries[row.key] = ledger.entry(row)
            if entries[row.key].state != "done" and not control.cancelled:
                ledger.forget(row)
                entries[row.key] = Entry(row, "missing")
                tasks.append(Task(row, os.fspath(ledger.folder), identity))
        notes = Notes(ledger, on_change, entries)
        if not tasks or control.cancelled:
            pass
        elif self.cluster.is_local and min(self.cluster.processes, len(tasks)) == 1:
            self._by_one(tasks, notes, control)
        else:
            self._by_many(tasks, notes, control)
        # not read from the folder again, which takes long for many rows
        return [
            replace(entries[row.key], row=row) if row.key in entries else Entry(row, "missing")
            for row in rows
        ]

    def _by_one(self, tasks: list[Task], notes: Notes, control: Control) -> None:
        """Solve in one process, replaced when it dies, and ended when no more is wanted."""
        if self._one is None:
            self._one = self._open.enter_context(closing(Worker(stateless, ENDED, ONE_THREAD)))
        worker, over = self._one, threading.Event()

        def close() -> None:
            over.wait()
            if control.cancelled:
                worker.close()  # who waits for the row under way is told

        def watch(control: Control) -> None:
            if control.cancelled:
                over.set()

        # not by who cancels, such as a signal's handler in the middle of a call to the worker
        closer = threading.Thread(target=close, daemon=True)
        closer.start()
        try:
            with control.watched(watch):
                for task in tasks:
                    answer = _tried(worker, task, control)
                    if answer is None:
                        return
                    notes.write(task, answer)
        finally:
            over.set()
            closer.join()
            if control.cancelled:
                self._one = None

    def _by_many(self, tasks: list[Task], notes: Notes, control: Control) -> None:
        # not where one process does it all
        from abfm.batch.on_dask import OnDask

        if self._dask is None:
            self._dask = self._open.enter_context(OnDask(self.cluster))
        self._dask.solve(tasks, notes, control)


class Notes:
    """Keeps the entry of each task that ends, by the key of its row, and reports it; a warning only
    for the first row that has it.
    """

    def __init__(
        self, ledger: Ledger, on_change: Callable[[Entry], object], entries: dict[str, Entry]
    ) -> None:
        self.ledger, self._on_change, self._entries = ledger, on_change, entries
        self._warned = set[str]()

    def is_written(self, task: Task) -> bool:
        """Report a task whose worker has written its entry; return False if it has not."""
        entry = self.ledger.entry(task.row)
        if entry.state == "missing":
            return False
        self._keep(entry)
        return True

    def write(self, task: Task, answer: Answer) -> None:
        """Write the entry of a task, and report it."""
        if answer.result is not None:
            self.ledger.write_result(answer.record.digest, answer.result)
        self._keep(self.ledger.record(task.row, answer.record))

    def _keep(self, entry: Entry) -> None:
        self._entries[entry.row.key] = entry
        text = entry.record.warning
        if text and text not in self._warned:
            self._warned.add(text)
            warnings.warn(f"row {one_line(entry.row.name)}: {text}", AbfmWarning, stacklevel=2)
        self._on_change(entry)


def _tried(worker: Worker[None], task: Task, control: Control) -> Answer | None:
    """Try a task in a worker that may die; None where no answer is wanted any more."""
    for tries in range(1, TRIES + 1):
        try:
            answer = worker.call(_attempt, task).result()
            if answer.is_blind:  # they are nowhere, which the row tells itself
                answer = worker.call(_attempt, replace(task, contents={})).result()
        except WorkerEndedError:
            if control.cancelled:
                return None
        else:
            return replace(answer, record=replace(answer.record, tries=tries))
    return Answer(Record(reason=ENDED, tries=TRIES))


def _attempt(state: None, task: Task) -> Answer:
    return attempt(task)


def seen_here(task: Task) -> Task:
    """Return a task with the contents of its files, as far as they are seen here."""
    contents = {}
    for path in task.row.files():
        try:
            contents[path] = read_bytes(path)
        except OSError:
            continue  # the row tells itself that it is missing
    return replace(task, contents=contents)

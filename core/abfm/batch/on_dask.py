"""Rows on `dask.distributed`. It keeps no state: what is done is in the ledger."""

from __future__ import annotations

import logging
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from abfm.batch.attempt import Answer, Task, attempt
from abfm.batch.ledger import Ledger, Record
from abfm.batch.local_cluster import MODULE, Wanted
from abfm.batch.run import ENDED, ONE_THREAD, TRIES, Cluster, Notes, seen_here
from abfm.errors import AbfmError, ResultError, one_line
from abfm.workers.control import Control
from abfm.workers.process import OwnProcess, ProcessEndedError

if TYPE_CHECKING:
    from distributed import Client, Future

_EVERY = 0.1  # seconds between two looks at whether it is to go on
_CLOSING = 2.0  # seconds for saying goodbye
_LOGGERS = "distributed", "tornado", "asyncio"
_ALIVE = "running", "connecting"  # states of a client
_MOST_STARTS = 4  # of a cluster that dies, without a row between


class _LostError(Exception):
    """The scheduler is gone."""


class OnDask:
    """A Dask cluster that solves tasks, to be used in a ``with``: it is connected to, or started
    where it is this machine's, when there are first some, and kept for the next ones.
    """

    def __init__(self, cluster: Cluster) -> None:
        self.cluster, self._client, self._processes = cluster, None, 0
        self._quiet, self._connection = ExitStack(), ExitStack()

    def __enter__(self) -> OnDask:
        return self

    def __exit__(self, *_: object) -> None:
        self._disconnect()
        self._quiet.close()

    def solve(self, tasks: list[Task], notes: Notes, control: Control) -> None:
        """Solve tasks, and take down what comes of each as it comes."""
        if find_spec("distributed") is None:
            raise AbfmError(
                'several processes need dask.distributed: pip install "abfm[cluster]", or say '
                "--jobs 1"
            )
        left = {task.row.key: task for task in tasks}
        starts = 0

        def done(task: Task) -> None:
            nonlocal starts
            starts = 0
            del left[task.row.key]

        ledger = notes.ledger
        while left and not control.cancelled:
            starts += 1
            try:
                client = self._connected(ledger, len(left))
                _submitted(client, list(left.values()), notes, done, control)
            except _LostError as error:
                self._disconnect()
                if not self.cluster.is_local:
                    raise ResultError(
                        f"the scheduler does not answer any more; {len(left)} rows are left: run "
                        "the same again to go on"
                    ) from error
                if starts == _MOST_STARTS:
                    raise ResultError(
                        f"the processes of this machine ended {starts} times before a row was "
                        f"done; see {one_line(_log(ledger))}, or say --jobs 1"
                    ) from error
        if control.cancelled and self.cluster.is_local:
            self._disconnect()  # rows under way would go on before those of the next run

    def _connected(self, ledger: Ledger, tasks: int) -> Client:
        """Return the client, of a cluster of as many processes as so many tasks can use."""
        wanted = min(self.cluster.processes, tasks) if self.cluster.is_local else 0
        client: Client | None = self._client
        if client is None or client.status not in _ALIVE or wanted > self._processes:
            self._disconnect()
            connection = _connected(self.cluster, ledger, wanted, self._quiet)
            client = self._client = self._connection.enter_context(connection)
            self._processes = wanted
        return client

    def _disconnect(self) -> None:
        self._client = None
        self._connection.close()


def _submitted(
    client: Client,
    tasks: list[Task],
    notes: Notes,
    done: Callable[[Task], None],
    control: Control,
) -> None:
    """Submit tasks and wait for them, or until no more are wanted."""
    token, ended = secrets.token_hex(4), SimpleQueue[str]()
    waiting: dict[str, tuple[Future[Any], Task]] = {}

    def submit(task: Task) -> None:
        kind = "seen" if task.contents is None else "sent"
        key = f"abfm-{task.row.key[:24]}-{token}-{kind}"
        future = client.submit(attempt, task, key=key, pure=False)
        waiting[key] = future, task
        future.add_done_callback(lambda future: ended.put(future.key))

    for task in tasks:
        submit(task)
    while waiting:
        if control.cancelled:
            client.cancel([future for future, _ in waiting.values()])
            return
        try:
            key = ended.get(timeout=_EVERY)
        except Empty:
            if client.status not in _ALIVE:
                raise _LostError from None
            continue
        future, task = waiting.pop(key)
        # the ledger is asked first: answers are lost with the worker that has them
        if not (future.status == "finished" and notes.is_written(task)):
            answer = _answer(future)
            if answer.is_blind:
                submit(seen_here(task))
                continue
            notes.write(task, answer)
        done(task)


def _answer(future: Future[Any]) -> Answer:
    from distributed import KilledWorker

    if future.status not in ("finished", "error"):
        raise _LostError
    try:
        answer: Answer = future.result()
        return answer
    except KilledWorker:
        return Answer(Record(reason=ENDED, tries=TRIES))
    except Exception as error:
        if future.status not in ("finished", "error"):
            raise _LostError from error
        return Answer(Record(reason=f"{type(error).__name__}: {one_line(error)}"))


@contextmanager
def _connected(
    cluster: Cluster, ledger: Ledger, processes: int, quiet: ExitStack
) -> Iterator[Client]:
    """Yield a client of the cluster, which is started where it is this machine's, with so many
    processes, and have nothing logged until all ends.
    """
    process = None
    try:
        if cluster.is_local:
            process = OwnProcess(MODULE, ONE_THREAD)
            process.send(Wanted(processes, os.fspath(_log(ledger)), TRIES))
        from distributed import Client  # which takes a while, as the process does to start

        quiet.enter_context(_silent())
        if process is not None:
            where = {"address": process.receive()}
        elif cluster.scheduler is not None:
            where = {"address": cluster.scheduler}
        else:
            where = {"scheduler_file": os.fspath(cluster.scheduler_file or "")}
        client = _client(Client, where)
    except ProcessEndedError as error:
        raise _LostError from error
    else:
        try:
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=_CLOSING)
    finally:
        if process is not None:
            process.close()


def _client(make: Callable[..., Client], where: dict[str, str]) -> Client:
    name = next(iter(where.values()))
    if "scheduler_file" in where and not os.path.isfile(name):
        raise ResultError(f"there is no scheduler's file {one_line(name)}")
    try:
        return make(**where, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError) as error:
        raise ResultError(
            f"no scheduler answers at {one_line(name)}: {one_line(error, 120)}"
        ) from error


def _log(ledger: Ledger) -> Any:
    return ledger.own / "workers.log"


@contextmanager
def _silent() -> Iterator[None]:
    """Have nothing logged of connections that break, which is told in one line or mended."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith(_LOGGERS)]
    loggers = [logging.getLogger(name) for name in (*_LOGGERS, *names)]
    before = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for logger, level in reversed([*zip(loggers, before, strict=True)]):
            logger.setLevel(level)

"""Rows on `dask.distributed`. It keeps no state: what is done is in the ledger."""

from __future__ import annotations

import gc
import logging
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from abfm.batch.attempt import Answer, Task, attempt
from abfm.batch.ledger import Ledger, Record
from abfm.batch.local_cluster import MODULE, Wanted
from abfm.batch.rows import own_version
from abfm.batch.run import (
    CONNECTING,
    ENDED,
    NO_WORKERS,
    ONE_THREAD,
    TRIES,
    Cluster,
    LostError,
    Notes,
    seen_here,
)
from abfm.errors import AbfmError, ResultError, one_line
from abfm.reading import from_json, read_bytes
from abfm.workers.control import CancelledError, Control
from abfm.workers.process import OwnProcess, ProcessEndedError
from abfm.workers.progress import step

if TYPE_CHECKING:
    from distributed import Client, Future

_EVERY = 0.1  # seconds between two looks at whether it is to go on
_COUNTS_EVERY = 2.0  # seconds between two looks at whether there are workers
_CLOSING = 2.0  # seconds for saying goodbye
_LOGGERS = "distributed", "tornado", "asyncio"
_ALIVE = "running", "connecting"  # states of a client
_MOST_STARTS = 4  # of a cluster that dies, without a row between
_LARGEST = 64 << 20  # bytes of a scheduler's file
TASKS_SUBMITTED_MAX = 2000
"""Tasks that a cluster has at once: more than it has workers, and few enough to cancel quickly."""


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
                client = self._connected(ledger, len(left), control)
                _submitted(client, list(left.values()), notes, done, control)
            except CancelledError:
                break
            except _LostError as error:
                self._disconnect()
                if not self.cluster.is_local:
                    raise LostError(
                        f"the scheduler does not answer any more; {len(left)} rows are left: run "
                        "the same again to go on"
                    ) from error
                if starts == _MOST_STARTS:
                    raise LostError(
                        f"the processes of this machine ended {starts} times before a row was "
                        f"done; see {one_line(_log(ledger))}, or say --jobs 1"
                    ) from error
        if control.cancelled and self.cluster.is_local:
            self._disconnect()  # rows under way would go on before those of the next run

    def _connected(self, ledger: Ledger, tasks: int, control: Control) -> Client:
        """Return the client, of a cluster of as many processes as so many tasks can use."""
        wanted = min(self.cluster.processes, tasks) if self.cluster.is_local else 0
        client: Client | None = self._client
        if client is None or client.status not in _ALIVE or wanted > self._processes:
            self._disconnect()
            connection = _connected(self.cluster, ledger, wanted, self._quiet, control)
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

    following = iter(tasks)
    with _workers_told(client) as look:
        while True:
            if control.cancelled:
                client.cancel([future for future, _ in waiting.values()])
                return
            if len(waiting) < TASKS_SUBMITTED_MAX and (task := next(following, None)):
                submit(task)
                continue
            if not waiting:
                return
            try:
                key = ended.get(timeout=_EVERY)
            except Empty:
                if client.status not in _ALIVE:
                    raise _LostError from None
                look()
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


@contextmanager
def _workers_told(client: Client) -> Iterator[Callable[[], None]]:
    """Yield what is to be called again and again, and tells while the cluster has no workers."""
    looked, is_told = 0.0, False
    with ExitStack() as told:

        def look() -> None:
            nonlocal looked, is_told
            if time.monotonic() - looked < _COUNTS_EVERY:
                return
            workers = True  # or unknown, as of a scheduler that is gone, which is told elsewhere
            with suppress(Exception):
                workers = bool(client.sync(client.scheduler.ncores, callback_timeout=_CLOSING))
            if is_told and workers:
                told.close()
            elif not (is_told or workers):
                told.enter_context(step(NO_WORKERS))
            looked, is_told = time.monotonic(), not workers

        yield look


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
    cluster: Cluster, ledger: Ledger, processes: int, quiet: ExitStack, control: Control
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
            client = _client(Client, process.receive(), control)
        else:
            address = cluster.scheduler
            if address is None:
                address = _address_in(cluster.scheduler_file or "")
            with step(CONNECTING):
                client = _client(Client, address, control)
    except ProcessEndedError as error:
        raise _LostError from error
    else:
        try:
            if process is None:
                _check_alike(client)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=_CLOSING)
    finally:
        if process is not None:
            process.close()


def _address_in(path: str | os.PathLike[str]) -> str:
    """Return the address that a scheduler's file has."""
    name = one_line(path)
    if not os.path.isfile(path):
        raise ResultError(f"there is no scheduler's file {name}")
    try:
        content = read_bytes(path, _LARGEST)
    except OSError as error:
        raise ResultError(f"cannot read the scheduler's file {name}: {one_line(error)}") from error
    try:
        address = from_json(content)["address"]
    except (ValueError, KeyError, TypeError, IndexError):
        address = None
    if not (isinstance(address, str) and address):
        raise ResultError(
            f"{name} has no address: expected the file that a Dask scheduler writes once it runs"
        )
    return address


def _client(make: Callable[..., Client], address: str, control: Control) -> Client:
    """Connect, which takes half a minute where nobody answers, unless it is cancelled."""
    made = SimpleQueue["Client | str"]()

    def connect() -> None:
        try:
            client = make(address, set_as_default=False)
        except Exception as error:  # of any kind, where something answers that is no scheduler
            why = one_line(error, 120)
        else:
            made.put(client)
            if control.cancelled:
                client.close()
            return
        # what began to connect is closed now: later it may be while Dask has a lock of its own,
        # for which it would wait for ever
        gc.collect()
        made.put(why)

    threading.Thread(target=connect, daemon=True).start()
    while not control.cancelled:
        with suppress(Empty):
            client = made.get(timeout=_EVERY)
            if isinstance(client, str):
                raise ResultError(f"no scheduler answers at {one_line(address)}: {client}")
            return client
    raise CancelledError


def _check_alike(client: Client) -> None:
    """Refuse a cluster that has no abfm, whose workers would end, or another one."""
    here, found = own_version(), dict[str, Any]()
    try:
        found["the scheduler"] = client.run_on_scheduler(version, "abfm")
        of_workers = client.run(version, "abfm", on_error="return")
        found |= {f"worker {one_line(address)}": told for address, told in of_workers.items()}
    except PackageNotFoundError as error:
        found["the scheduler"] = error
    except OSError as error:
        raise _LostError from error
    for who, told in found.items():
        if isinstance(told, PackageNotFoundError) or (isinstance(told, str) and told != here):
            has = f"abfm {told}" if isinstance(told, str) else "no abfm"
            raise ResultError(f"{who} has {has}; install abfm {here} there, as it is here")


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

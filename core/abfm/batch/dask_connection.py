"""Connection to a Dask cluster whose executor solves rows.

The connection has no state: the ledger stores the finished rows.
"""

from __future__ import annotations

import gc
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from typing import Any

from abfm.batch.cluster import CONNECTING, NO_WORKERS, Cluster, ConnectionLostError
from abfm.batch.rows import installed_version
from abfm.errors import AbfmError, ResultError, one_line
from abfm.reading import from_json, read_bytes
from abfm.workers.control import CancelledError, Control
from abfm.workers.progress import step

_POLL_SECONDS = 0.1  # interval of checks for cancellation
_COUNT_SECONDS = 2.0  # interval of checks for workers
_CLOSE_SECONDS = 2.0  # timeout of closing the connection
_LOGGERS = "distributed", "tornado", "asyncio"
_SCHEDULER_FILE_BYTES_MAX = 64 << 20


class DaskConnection:
    """A connection to the scheduler of a cluster, until it is closed.

    ``control`` cancels waiting for the scheduler by a `CancelledError`. Raises AbfmError if there
    is no such scheduler, or its cluster has no abfm or another version of it.
    """

    def __init__(self, cluster: Cluster, control: Control) -> None:
        if find_spec("distributed") is None:
            raise AbfmError(
                "a cluster needs dask.distributed, which is not installed; run pip install "
                '"abfm[cluster]", or use processes of this machine (--jobs N)'
            )
        from distributed import Client  # optional and slow to import

        with ExitStack() as opened:
            opened.enter_context(_silent())
            address = cluster.scheduler or _address_in(cluster.scheduler_file or "")
            with step(CONNECTING):
                self._client = _client(Client, address, control)
            opened.callback(_close, self._client)
            _check_versions(self._client)
            self._opened = opened.pop_all()
        self.executor: Executor = self._client.get_executor(pure=False)

    @property
    def is_alive(self) -> bool:
        """Whether the client is connected; False while it reconnects, as its calls are lost."""
        return bool(self._client.status == "running")

    def close(self) -> None:
        """Cancel all calls at once, and close the connection."""
        with suppress(Exception):  # the scheduler may be gone
            self.executor.shutdown(wait=False)
        self._opened.close()

    @contextmanager
    def watched(self) -> Iterator[Callable[[], bool]]:
        """Yield a function that returns whether the scheduler answers; call it repeatedly.

        While the cluster has no workers, it reports the progress step `NO_WORKERS`.
        """
        checked, is_reported = 0.0, False
        with ExitStack() as reported:

            def is_alive() -> bool:
                nonlocal checked, is_reported
                if time.monotonic() - checked < _COUNT_SECONDS:
                    return self.is_alive
                has_workers, scheduler = True, self._client.scheduler
                with suppress(Exception):  # the scheduler may be gone
                    has_workers = bool(
                        self._client.sync(scheduler.ncores, callback_timeout=_CLOSE_SECONDS)
                    )
                if is_reported and has_workers:
                    reported.close()
                elif not (is_reported or has_workers):
                    reported.enter_context(step(NO_WORKERS))
                checked, is_reported = time.monotonic(), not has_workers
                return self.is_alive

            yield is_alive


def _close(client: Any) -> None:
    with suppress(Exception):
        client.close(timeout=_CLOSE_SECONDS)


def _address_in(path: str | os.PathLike[str]) -> str:
    name = one_line(path)
    if not os.path.isfile(path):
        raise ResultError(f"the scheduler file {name} does not exist")
    try:
        content = read_bytes(path, _SCHEDULER_FILE_BYTES_MAX)
    except OSError as error:
        raise ResultError(f"cannot read the scheduler file {name}: {one_line(error)}") from error
    try:
        address = from_json(content)["address"]
    except (ValueError, KeyError, TypeError, IndexError):
        address = None
    if not (isinstance(address, str) and address):
        raise ResultError(
            f"{name} has no address; expected the file that a running Dask scheduler wrote"
        )
    return address


def _client(make: Callable[..., Any], address: str, control: Control) -> Any:
    """Return a client connected to the scheduler; ``make`` is the class of the client.

    Raises ResultError if there is no answer within 30 seconds.
    """
    clients = SimpleQueue[Any]()

    def connect() -> None:
        try:
            client = make(address, set_as_default=False)
        except Exception as error:  # the error has any type if another service answers
            reason = one_line(error, 120)
        else:
            clients.put(client)
            if control.cancelled:
                client.close()
            return
        # collect the failed client now: collected later, while Dask has its lock, it would deadlock
        gc.collect()
        clients.put(reason)

    threading.Thread(target=connect, daemon=True).start()
    while not control.cancelled:
        with suppress(Empty):
            client = clients.get(timeout=_POLL_SECONDS)
            if isinstance(client, str):
                raise ResultError(
                    f"no scheduler answers at {one_line(address)}: {client}. Check its address"
                )
            return client
    raise CancelledError


def _check_versions(client: Any) -> None:
    """Raise ResultError if the scheduler or a worker has another version of abfm, or none."""
    here, found = installed_version(), dict[str, Any]()
    try:
        found["the scheduler"] = client.run_on_scheduler(version, "abfm")
        of_workers = client.run(version, "abfm", on_error="return")
        found |= {
            f"worker {one_line(address)}": member_version
            for address, member_version in of_workers.items()
        }
    except PackageNotFoundError as error:
        found["the scheduler"] = error
    except OSError as error:
        raise ConnectionLostError(f"the scheduler no longer answers: {one_line(error)}") from error
    for member, member_version in found.items():
        if isinstance(member_version, PackageNotFoundError) or (
            isinstance(member_version, str) and member_version != here
        ):
            has = f"abfm {member_version}" if isinstance(member_version, str) else "no abfm"
            raise ResultError(
                f"{member} has {has}; install abfm {here} there, the version on this machine"
            )


@contextmanager
def _silent() -> Iterator[None]:
    """Disable Dask's logs of broken connections, which this module reports itself."""
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

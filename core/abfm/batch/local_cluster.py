"""A cluster of this machine's cores, in a process of its own: ``python -m
abfm.batch.local_cluster``.

So a signal to a terminal's processes does not reach it, what Dask logs does not mix with what is
printed, and it can be started anew if it dies. It ends when the other end is gone, however that
happened, and its workers end with it.
"""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from typing import TYPE_CHECKING, NamedTuple

from abfm.io import remove_temporary, temporary_folder
from abfm.workers.process import Requests

if TYPE_CHECKING:
    from distributed import LocalCluster

MODULE = "abfm.batch.local_cluster"
HOST = "127.0.0.1"
_EVERY = 1.0  # seconds between two looks at whether workers are lost
_GONE = "failed", "closed"  # states of what starts a worker, and starts it no more


class Wanted(NamedTuple):
    """What the first message says."""

    workers: int
    log: str  # file for what workers print
    tries: int  # of a task whose worker dies


def main() -> None:
    """Serve until the other end is gone."""
    requests = Requests()
    wanted: Wanted = next(iter(requests))
    log = os.open(wanted.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o666)
    for number in (1, 2):
        os.dup2(log, number)
    import dask
    from distributed import LocalCluster

    warnings.simplefilter("ignore")
    dask.config.set(
        {
            "distributed.scheduler.allowed-failures": wanted.tries - 1,
            # a worker holds no task besides the one it works on, which would die with it
            "distributed.scheduler.worker-saturation": 1.0,
            "distributed.scheduler.work-stealing": False,
            "distributed.scheduler.worker-ttl": None,  # libraries hold the interpreter for long
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
            # one that starts anew may take long on a machine that has much to do
            "distributed.deploy.lost-worker-timeout": "1h",
            "distributed.worker.profile.enabled": False,
            "distributed.admin.tick.limit": "1h",
        }
    )
    with temporary_folder() as folder:
        cluster = LocalCluster(
            n_workers=wanted.workers,
            threads_per_worker=1,
            processes=True,
            host=HOST,
            dashboard_address=f"{HOST}:0",  # of what follows: no pages, and no fixed port
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,  # what a match needs, it needs: the system says when there is no more
            local_directory=os.fspath(folder),
        )
        requests.answer(cluster.scheduler_address)
        threading.Thread(target=_tend, args=(cluster, wanted.workers), daemon=True).start()
        for _ in requests:
            pass
        _end(0)


def _tend(cluster: LocalCluster, count: int) -> None:
    """Have as many workers as are wanted, and end where none is left: a client waits for them."""
    while mend(cluster, count):
        time.sleep(_EVERY)
    _end(1)


def mend(cluster: LocalCluster, count: int) -> int:
    """Start workers that Dask has given up, as one that dies while it starts, and return how many
    are left of so many.
    """
    lost = [name for name, each in list(cluster.workers.items()) if each.status.name in _GONE]
    left = len(cluster.workers) - len(lost)

    def start() -> None:
        for name in lost:
            cluster.workers.pop(name, None)
        cluster.scale(count)

    if left < count:
        cluster.loop.add_callback(start)
    return left


def _end(status: int) -> None:
    remove_temporary()
    sys.stdout.flush()
    os._exit(status)


if __name__ == "__main__":  # the workers' processes import this module by another name
    main()

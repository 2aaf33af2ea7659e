"""The function `solve_many`, which matches problems in threads, processes or on a cluster."""

from __future__ import annotations

import os
import pickle
import platform
import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from abfm.io import temporary_folder
from abfm.matching.match import match
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solving.record import Iteration
from abfm.mesh import TriangleMesh
from abfm.workers.control import Control
from abfm.workers.executor import completed, in_order
from abfm.workers.messages import Parcel, pack

_CHECK_SECONDS = 0.1  # time between two checks whether a match is still needed
_MESHES_CACHED_MAX = 2  # meshes with their operators in each process


def solve_many(problems: Iterable[Problem], executor: Executor) -> Iterator[Match]:
    """Match many problems on an executor; yield the matches in the order of the problems.

    Each process caches the last meshes and their operators for the following problems. Workers
    return matches without meshes, and ``match.mesh`` is the mesh of the problem. The work starts
    when the first match is requested. Closing the iterator cancels the other problems, and stops
    running matches on this machine.

    Parameters
    ----------
    problems : iterable of Problem
    executor : concurrent.futures.Executor
        Executor of the matches, for example a ``ProcessPoolExecutor``, or ``client.get_executor()``
        of ``dask.distributed``. One match uses one core, so use as many workers as there are cores.

    Yields
    ------
    Match

    Raises
    ------
    AbfmError
        If `match` raises it for a problem. This error, like any error of the executor, ends the
        iteration.

    Examples
    --------
    >>> import abfm
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("eight.off"))
    >>> f, *targets = (abfm.function(mesh, f"gaussian:vertex={i},width=0.2") for i in (0, 2, 3))
    >>> problems = [abfm.Problem(mesh, f, g) for g in targets]
    >>> with ThreadPoolExecutor(2) as executor:
    ...     [match.mesh is mesh for match in abfm.solve_many(problems, executor)]
    [True, True]
    """
    numbered, meshes = deque(enumerate(problems)), dict[str, bytes]()
    named, submitted = dict[int, dict[str, Any]](), list[Future[Parcel]]()
    with temporary_folder() as folder:
        marker = folder / "running"
        marker.touch()

        def submit(task: tuple[int, Problem]) -> Future[Parcel]:
            number, problem = task
            parcel, named[number] = pack(problem, meshes)
            meshes.update(parcel.values)
            sent = parcel._replace(values={name: meshes[name] for name in parcel.names})
            submitted.append(executor.submit(_solve, _Task(sent, marker, _disk(folder))))
            return submitted[-1]

        try:
            ended = completed(submit, numbered, marker.exists)
            futures = in_order((number, future) for (number, _), future in ended)
            for number, future in enumerate(futures):
                yield future.result().unpack(named.pop(number))[0]
        finally:
            marker.unlink()
            for future in submitted:
                future.cancel()


class _Task(NamedTuple):
    """A problem for a worker, which stops when the sender deletes the file ``marker``."""

    problem: Parcel
    marker: Path
    disk: tuple[str, int, int]


def _disk(folder: Path) -> tuple[str, int, int]:
    """Return an identifier of the disk of a temporary folder, also after the folder is deleted.

    It consists of the machine's name, and device and inode of the parent folder. Different machines
    may have equal devices and inodes, and different containers equal names.
    """
    try:
        found = folder.parent.stat()
    except OSError:
        return platform.node(), 0, 0
    return platform.node(), found.st_dev, found.st_ino


@lru_cache(maxsize=_MESHES_CACHED_MAX)
def _mesh(content: bytes) -> TriangleMesh:
    mesh: TriangleMesh = pickle.loads(content)
    return mesh


def _solve(task: _Task) -> Parcel:
    meshes = {name: _mesh(content) for name, content in task.problem.values.items()}
    problem, _ = task.problem._replace(values={}).unpack(meshes)
    control, checked = Control(), time.monotonic()
    is_here = task.disk == _disk(task.marker.parent)  # other machines cannot read the file

    def check(now: Iteration) -> None:
        nonlocal checked
        if is_here and time.monotonic() - checked > _CHECK_SECONDS:
            checked = time.monotonic()
            if not os.path.exists(task.marker):
                control.cancel(skip_checks=True)

    return pack(match(problem, on_iteration=check, control=control), meshes)[0]

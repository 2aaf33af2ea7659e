"""Many problems on any executor: threads, processes, or the machines of a cluster."""

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

_CHECK_SECONDS = 0.1  # between two checks whether a match is still wanted
_MESHES_KEPT = 2  # by a process, with what was computed from them


def solve_many(problems: Iterable[Problem], executor: Executor) -> Iterator[Match]:
    """Match many problems on an executor; yield the matches in the order of the problems.

    A process keeps the last meshes, and what was computed from them, for the problems that follow.
    Matches come back without their meshes: ``match.mesh`` is the problem's own. All begins when the
    first match is requested. Closing the iterator cancels the other problems, and stops those under
    way on this machine.

    Parameters
    ----------
    problems : iterable of Problem
    executor : concurrent.futures.Executor
        Such as a ``ProcessPoolExecutor``, or ``client.get_executor()`` of ``dask.distributed``.
        One match takes one core: as many workers as there are cores.

    Raises
    ------
    AbfmError
        In the place of a problem that cannot be solved, as `match` raises it; as other errors, such
        as of the executor, it ends all.

    Examples
    --------
    >>> import abfm
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("eight.off"))
    >>> f, *targets = (abfm.function(mesh, f"gaussian:vertex={i},width=0.2") for i in (0, 9, 12))
    >>> problems = [abfm.Problem(mesh, f, g) for g in targets]
    >>> with ThreadPoolExecutor(2) as executor:
    ...     [match.mesh is mesh for match in abfm.solve_many(problems, executor)]
    [True, True]
    """
    numbered, meshes = deque(enumerate(problems)), dict[str, bytes]()
    named, submitted = dict[int, dict[str, Any]](), list[Future[Parcel]]()
    with temporary_folder() as folder:
        wanted = folder / "wanted"
        wanted.touch()

        def submit(task: tuple[int, Problem]) -> Future[Parcel]:
            number, problem = task
            parcel, named[number] = pack(problem, meshes)
            meshes.update(parcel.values)
            sent = parcel._replace(values={name: meshes[name] for name in parcel.names})
            submitted.append(executor.submit(_solve, _Task(sent, wanted, _disk(folder))))
            return submitted[-1]

        try:
            ended = completed(submit, numbered, wanted.exists)
            futures = in_order((number, future) for (number, _), future in ended)
            for number, future in enumerate(futures):
                yield future.result().unpack(named.pop(number))[0]
        finally:
            wanted.unlink()
            for future in submitted:
                future.cancel()


class _Task(NamedTuple):
    """A problem as it is sent, and a file on the disk of the sender's machine that exists while its
    match is wanted.
    """

    problem: Parcel
    wanted: Path
    disk: tuple[str, int, int]


def _disk(folder: Path) -> tuple[str, int, int]:
    """Return what identifies the folder of temporary files above, also after this one is deleted.

    Machines with equal disks differ in their names, containers with equal names in their disks.
    """
    try:
        found = folder.parent.stat()
    except OSError:
        return platform.node(), 0, 0
    return platform.node(), found.st_dev, found.st_ino


@lru_cache(maxsize=_MESHES_KEPT)
def _mesh(content: bytes) -> TriangleMesh:
    mesh: TriangleMesh = pickle.loads(content)
    return mesh


def _solve(task: _Task) -> Parcel:
    """Solve a problem, and return its match without meshes."""
    meshes = {name: _mesh(content) for name, content in task.problem.values.items()}
    problem, _ = task.problem._replace(values={}).unpack(meshes)
    control, checked = Control(), time.monotonic()
    is_here = task.disk == _disk(task.wanted.parent)  # another machine does not see the file

    def check(now: Iteration) -> None:
        nonlocal checked
        if is_here and time.monotonic() - checked > _CHECK_SECONDS:
            checked = time.monotonic()
            if not os.path.exists(task.wanted):
                control.cancel(skip_checks=True)

    return pack(match(problem, on_iteration=check, control=control), meshes)[0]

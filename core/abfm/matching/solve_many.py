"""Many problems on any executor: threads, processes, or the machines of a cluster."""

from __future__ import annotations

import json
import math
import os
import pickle
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, wait
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple
from weakref import WeakValueDictionary

from abfm.io import temporary_folder
from abfm.matching.match import match
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solving.record import Iteration
from abfm.mesh import TriangleMesh
from abfm.workers.control import Control
from abfm.workers.messages import Parcel, pack

_EVERY = 0.1  # seconds between two reports of a problem, and between two readings of them
_LAST = 10.0  # seconds for those under way to end when no more are asked for
_KEPT = 2  # meshes that a process keeps, with what was computed from them
_REPORT = ".json"  # the end of files with reports
_GO_ON = "go on"  # file in the folder that all share: without it they stop


@dataclass(frozen=True)
class Report:
    """What one of many problems has come to."""

    index: int  # which one, from 0
    iteration: int  # steps taken
    energy: float  # of the iterate, as in `Iteration`, and its residual
    residual: float


class Monitor:
    """Watches what `solve_many` does, and stops it, if the problems see this temporary folder.

    Parameters
    ----------
    on_report : callable, optional
        Called with a `Report` in the thread that iterates, for each problem a few times a second;
        ``reports`` has the latest one of each problem by its index.
    """

    def __init__(self, on_report: Callable[[Report], object] = lambda report: None) -> None:
        self.reports: dict[int, Report] = {}
        self.stopped = False
        self._on_report = on_report

    def stop(self) -> None:
        """Let problems under way end with their best field, and begin no other; in any thread."""
        self.stopped = True

    def update(self, folder: Path) -> None:
        if self.stopped:
            (folder / _GO_ON).unlink(missing_ok=True)
        for file in folder.glob(f"*{_REPORT}"):
            with suppress(OSError, ValueError):  # it is over, or just being written
                report = Report(**json.loads(file.read_text()))
                if report != self.reports.get(report.index):
                    self.reports[report.index] = report
                    self._on_report(report)


def solve_many(
    problems: Iterable[Problem], executor: Executor, *, monitor: Monitor | None = None
) -> Iterator[Match]:
    """Match many problems on an executor; yield the matches in the order of the problems.

    A process gets a mesh once, by way of a temporary file, and keeps what was computed from it for
    the problems that follow; a machine that does not see this file gets the mesh with each problem.
    Matches come back without it: ``match.mesh`` is the problem's own. All begins when the first
    match is asked for; when no more are asked for, those under way are stopped.

    Parameters
    ----------
    problems : iterable of Problem
    executor : concurrent.futures.Executor
        Such as a ``ProcessPoolExecutor``, or ``client.get_executor()`` of ``dask.distributed``.
        One match takes one core: as many workers as there are cores.
    monitor : Monitor, optional
        Of all problems, and to stop them: then those that have not begun, and all after the first
        of them, are left out.

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
    monitor = monitor or Monitor()
    with temporary_folder() as folder:
        (folder / _GO_ON).touch()
        tasks = _tasks(problems, folder)
        futures = [executor.submit(_solve, task) for task, _ in tasks]
        try:
            for (task, named), future in zip(tasks, futures, strict=True):
                found = _result(future, folder, monitor)
                if found is None and not monitor.stopped:  # the folder is not seen there
                    found = _result(executor.submit(_solve, task.whole()), folder, monitor)
                if found is None:
                    return
                yield found.unpack(named)[0]
        finally:
            (folder / _GO_ON).unlink(missing_ok=True)
            # those under way still write in the folder, which is removed then
            wait([future for future in futures if not future.cancel()], _LAST)


class _Task(NamedTuple):
    """A problem as it is sent: meshes stand in it by name, and lie in a folder by that name."""

    number: int
    folder: Path
    parcel: Parcel

    def whole(self) -> _Task:
        values = {name: (self.folder / name).read_bytes() for name in self.parcel.names}
        return self._replace(parcel=self.parcel._replace(values=values))

    def mesh(self, name: str) -> TriangleMesh:
        content = self.parcel.values.get(name) or (self.folder / name).read_bytes()
        mesh: TriangleMesh = pickle.loads(content)
        return mesh

    def goes_on(self) -> bool:
        """Tell whether the folder is seen, and nobody has stopped."""
        return os.path.exists(self.folder / _GO_ON)


def _tasks(
    problems: Iterable[Problem], folder: Path
) -> list[tuple[_Task, dict[str, TriangleMesh]]]:
    tasks, written = [], set[str]()
    for index, problem in enumerate(problems):
        parcel, named = pack(problem, written)
        for name, content in parcel.values.items():
            (folder / name).write_bytes(content)
            _meshes.here[name] = named[name]
        written.update(parcel.names)
        tasks.append((_Task(index, folder, parcel._replace(values={})), named))
    return tasks


def _result(future: Future[Parcel | None], folder: Path, monitor: Monitor) -> Parcel | None:
    """Wait for a problem; meanwhile take in the reports of all, and tell them to stop."""
    while not wait([future], _EVERY).done:
        monitor.update(folder)
        if monitor.stopped:
            future.cancel()
    return None if future.cancelled() else future.result()


class _Meshes:
    """The last few meshes of this process, and all of a `solve_many` that goes on here."""

    def __init__(self) -> None:
        self.here: WeakValueDictionary[str, TriangleMesh] = WeakValueDictionary()
        self._kept: OrderedDict[str, TriangleMesh] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, name: str, load: Callable[[str], TriangleMesh]) -> TriangleMesh:
        with self._lock:
            mesh = self.here.get(name) or self._kept.pop(name, None) or load(name)
            self._kept[name] = mesh
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return mesh


_meshes = _Meshes()


def _solve(task: _Task) -> Parcel | None:
    """Solve a problem; None where the folder is not there, as it is not seen or all is over."""
    is_seen = task.goes_on()
    if not (is_seen or task.parcel.values):
        return None
    named = {name: _meshes.get(name, task.mesh) for name in task.parcel.names}
    problem, _ = task.parcel._replace(values={}).unpack(named)
    control, latest = Control(), -math.inf

    def report(now: Iteration) -> None:
        nonlocal latest
        if is_seen and time.monotonic() - latest > _EVERY:
            latest = time.monotonic()
            if not task.goes_on():
                control.cancel()
            latest_report = Report(task.number, now.iteration, now.energy, now.residual)
            file = task.folder / f"{task.number}{_REPORT}"
            with suppress(OSError):  # all is over
                file.with_suffix(".new").write_text(json.dumps(asdict(latest_report)))
                file.with_suffix(".new").replace(file)

    return pack(match(problem, on_iteration=report, control=control), named)[0]

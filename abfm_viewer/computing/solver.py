"""The solver as the session knows it: one run at a time, restarted when the document changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abfm.types import FloatArray
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.memo import Memo
from abfm_viewer.computing.worker import Problem, Snapshot, Worker
from abfm_viewer.document.document import Run

if TYPE_CHECKING:
    from abfm import Match


class Solver:
    """At most one run.

    Attributes
    ----------
    follow : bool
        Whether a change of the problem during a run restarts it from the current field.
    warm : bool
        Whether a new run starts from the current field instead of zero.
    reason : str
        Why the last run ended.
    failed : bool
        Whether it ended with an error, which `reason` is then.
    """

    def __init__(self) -> None:
        self.follow = True
        self.warm = False
        self.worker: Worker | None = None
        self.reason = ""
        self.failed = False
        self._run = Memo[Run]()

    @property
    def running(self) -> bool:
        """Whether a run has begun and not ended; also while it is paused."""
        return self.worker is not None

    @property
    def paused(self) -> bool:
        """Whether the run waits."""
        return self.worker is not None and self.worker.paused

    @property
    def finished(self) -> bool:
        """Whether there was a run and it ended, well or not."""
        return self.worker is None and self.reason != ""

    @property
    def snapshot(self) -> Snapshot | None:
        """The newest iterate of the run."""
        return self.worker.snapshot if self.worker else None

    @property
    def run(self) -> Run | None:
        """The energies of the run so far."""
        if self.worker is None or self.worker.rows == 0:
            return None
        return self._run.get((self.worker, self.worker.rows), self.worker.run)

    def start(self, problem: Problem, functions: Functions, field: FloatArray | None) -> None:
        """Begin a run."""
        self.forget()
        self.worker = Worker(problem, functions, field)

    def pause(self) -> None:
        """Hold the run."""
        if self.worker:
            self.worker.pause()

    def resume(self) -> None:
        """Go on."""
        if self.worker:
            self.worker.resume()

    def cancel(self) -> None:
        """End the run and keep its best field."""
        if self.worker:
            self.worker.cancel()

    def follow_problem(self, problem: Problem, dragging: bool) -> None:
        """Restart with a changed problem; another alpha, which must be factored, only when the mouse lets go."""
        worker = self.worker
        if worker is None or problem == worker.problem:
            return
        if problem.mesh is not worker.problem.mesh:
            worker.cancel()
            return
        if not self.follow or not problem.channels:
            return
        if dragging and problem.parameters.alpha != worker.problem.parameters.alpha:
            return
        worker.restart(problem)

    def collect(self) -> tuple[Match | None, Run | None, Problem] | None:
        """What a run that has ended leaves; None unless one has ended since the last call."""
        worker = self.worker
        if worker is None or worker.running:
            return None
        worker.wait()
        run = self.run
        self.worker = None
        self.failed = bool(worker.error)
        self.reason = worker.error or (worker.result.stop_reason if worker.result else "cancelled")
        return worker.result, run, worker.problem

    def forget(self) -> None:
        """Let the last run be as if it had not been."""
        self.reason, self.failed = "", False

    def close(self, seconds: float = 1) -> None:
        """End the thread; it ends between two evaluations, which is not waited for long."""
        if self.worker:
            self.worker.cancel()
            self.worker.wait(seconds)
            self.worker = None

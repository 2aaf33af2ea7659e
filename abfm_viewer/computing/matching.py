"""Matches in the background, whose problem can be replaced while it is solved."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

import abfm
from abfm import AbfmError, Parameters, TriangleMesh
from abfm.errors import StartError
from abfm.outcome import outcome_of
from abfm.types import FloatArray
from abfm_viewer.computing.background import Memo
from abfm_viewer.computing.evaluation import Evaluators
from abfm_viewer.computing.iterates import IteratePicture, better, fields, match, prepare
from abfm_viewer.computing.run import Run
from abfm_viewer.document.document import SIDES, Channel, InitialMap, Landmark, RunRecord
from abfm_viewer.document.surface_points import landmark_pairs

_ITERATIONS_BETWEEN_RESTARTS = 3
_numbers = itertools.count(1)  # numbers of solves, by which the subprocess stores fields


@dataclass(frozen=True)
class ProblemSpec:
    """A problem with its functions as texts; equal objects have the same solution."""

    mesh: TriangleMesh
    channels: tuple[Channel, ...]
    parameters: Parameters
    mask: str
    landmarks: tuple[Landmark, ...] = ()  # with points on both surfaces
    landmarks_alone: bool = False  # whether functions have no weight if there are landmarks
    initial: InitialMap | None = None  # from surface A to B, which is ``mesh``, if any

    @property
    def is_of_landmarks(self) -> bool:
        return self.landmarks_alone and bool(self.landmarks)

    def problem(self, functions: Evaluators) -> abfm.Problem:
        """Return the problem with the values of its functions, whose evaluation may take long."""
        specs = [[channel.spec(side) for channel in self.channels] for side in SIDES]
        source, target = (
            np.stack([functions.evaluate(spec, side) for spec in of_side], axis=1)
            for side, of_side in zip(SIDES, specs, strict=True)
        )
        mask = functions.evaluate(self.mask) if self.mask else None
        weights = [0.0 if self.is_of_landmarks else each.weight for each in self.channels]
        found = None if self.initial is None else self.initial.correspondence
        a = self.mesh if found is None else found.a
        landmarks = landmark_pairs(a, self.mesh, self.landmarks)
        if found is not None:
            return abfm.registration.prepare(
                a,
                self.mesh,
                source,
                target,
                initial=found,
                landmarks=landmarks,
                parameters=self.parameters,
                mask_b=mask,
                weights=weights,
            ).problem
        problem = abfm.Problem(
            self.mesh,
            source,
            target,
            self.parameters,
            mask=mask,
            weights=weights,
            landmarks=None if landmarks is None else (landmarks.a, landmarks.b),
            landmark_weights=None if landmarks is None else landmarks.weights,
        )
        return problem.with_specs(*specs)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The newest iterate of a problem, and the best iterate with an advected source (`shown`).

    The newest iterate is not always the best. For example, a new attempt of the solver starts with
    a larger residual than that of the previous attempt.
    """

    problem: ProblemSpec
    iteration: abfm.matching.Iteration
    shown: abfm.matching.Iteration
    # the steps of all other attempts at this problem, by the number of the attempt
    others: Mapping[int, tuple[abfm.matching.PathStep, ...]] = field(default_factory=dict)


class _History:
    """Energies and residuals of a run's iterates; one thread appends them, others read them."""

    def __init__(self) -> None:
        self._iterates: list[abfm.matching.Iteration] = []  # without fields
        self._restarts: list[int] = []
        self._record = Memo[RunRecord]()

    def begin(self) -> None:
        if self._iterates:
            self._restarts.append(len(self._iterates))

    def add(self, now: abfm.matching.Iteration) -> None:
        self._iterates.append(replace(now, view=IteratePicture(None), path=()))

    def record(self, residual: float, parameters: Parameters) -> RunRecord | None:
        """Return the record of the run so far, or None before the first iterate.

        It is the same object until the next iterate. ``residual`` is stored as that of the run.
        """
        iterates, restarts = self._iterates[:], tuple(self._restarts)

        def column(name: str, kind: type = np.float64) -> Any:
            return np.array([getattr(each, name) for each in iterates], dtype=kind)

        def make() -> RunRecord:
            sigma = "auto" if parameters.sigma is None else f"{parameters.sigma:g}"
            words = tuple(dict.fromkeys(word for each in iterates for word in each.term_energies))
            shares = [[each.term_energies.get(word, 0.0) for word in words] for each in iterates]
            energies = map(column, ("energy", "regularity", "mismatch_energy"))
            return RunRecord(
                np.stack([*energies], axis=1),
                column("stage", np.int64),
                restarts,
                residual,
                f"α {parameters.alpha:g}, β {parameters.beta:g}, σ {sigma}",
                column("vertices", np.int64),
                column("reach"),
                words if len(words) > 1 else (),
                np.array(shares)[:, : len(words) if len(words) > 1 else 0],
                column("residual"),
                column("sigma"),
                column("attempt", np.int64),
            )

        inputs = (len(iterates), residual, parameters, restarts)
        return self._record.get(inputs, make) if iterates else None


Then: TypeAlias = "Callable[[abfm.Match | None, RunRecord | None, ProblemSpec], object]"
"""Callback for the end of a run: result (None if it failed), record, and solved problem."""


class Matching:
    """Solves one match at a time in a subprocess; its problem can be replaced during the run."""

    def __init__(self, run: Run[Any]) -> None:
        self.follow = True  # whether a change of the problem during a run restarts it
        self.running = False  # whether the current run is a match
        self.problem: ProblemSpec | None = None  # the newest problem
        self.snapshot: Snapshot | None = None  # may be read at any time
        self._run = run
        self._history = _History()
        self._next: ProblemSpec | None = None
        self._current: ProblemSpec | None = None  # problem of the current solve
        self._best: Snapshot | None = None  # best of the current solve with its fields
        self._lock = threading.Lock()

    @property
    def record(self) -> RunRecord | None:
        problem = self.running and self.problem
        return self._history.record(0.0, problem.parameters) if problem else None

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Make the coarser meshes of a mesh in the subprocess, before a match needs them."""
        self._run.process.call(prepare, mesh, parameters)

    def start(
        self, problem: ProblemSpec, functions: Evaluators, then: Then, field: FloatArray | None
    ) -> None:
        """Start a run from a field, or from zero; ``then`` is called when it is collected."""
        self.running, self.snapshot = True, None
        self.problem = self._next = self._solved = problem
        self._found: abfm.Match | None = None
        self._since_restart = 0
        work = partial(self._solve_all, functions, field)
        recover = partial(self._recovered, functions)
        self._run.start(work, partial(self._end, then), recover)

    def follow_problem(self, problem: ProblemSpec, dragging: bool = False) -> None:
        """Restart the run if the problem has changed, or cancel it if the mesh has changed.

        While the user drags, a change of alpha does not restart the run, because the restart needs
        another factorisation.
        """
        if not self.running or self.problem is None or problem == self.problem:
            return
        if problem.mesh.digest != self.problem.mesh.digest:
            self._run.cancel()
            return
        refactors = problem.parameters.alpha != self.problem.parameters.alpha
        if not self.follow or not problem.channels or (dragging and refactors):
            return
        with self._lock:
            if self._run.is_active:
                self.problem = self._next = problem
                self._yield_to_next()

    def unfinished(self, snapshot: Snapshot, functions: Evaluators) -> tuple[abfm.Match, RunRecord]:
        """Return the match that would result from cancelling at a snapshot, and the run's record.

        Its field is that of the best iterate of the snapshot, and it is not verified. The snapshot
        is stored in case the run fails. The call waits for the subprocess, so drawing code must not
        make it. If the field is no longer stored, or the run is over, an `AbfmError` is raised.
        """
        history, now = self._history, snapshot.shown
        if (record := history.record(now.residual, snapshot.problem.parameters)) is None:
            raise AbfmError("the run of this iterate is over")
        reason = abfm.matching.StopReason.CANCELLED
        kind = outcome_of(now.residual, snapshot.problem.parameters.goal)
        found = abfm.Match(
            problem=snapshot.problem.problem(functions),
            fine_velocity=now.velocity,
            advected=now.advected,
            energy_history=record.energies,
            stages=record.stages,
            residual=now.residual,
            verified_residual=math.nan,
            folded=math.nan,
            stop_reason=reason,
            verdict=abfm.matching.Verdict(kind, reason, ""),
        )
        self._store(snapshot)
        return found, record

    def _end(self, then: Then, found: abfm.Match | None) -> None:
        record = self.record
        if record is not None:
            ends = [step.residual for step in found.path] if found else record.residuals[-1:]
            record = replace(record, residual=float(min(ends)))
        self.running, self.snapshot, self._found, self._best = False, None, None, None
        self._history = _History()
        then(found, record, self._solved)

    # The methods below are called in the thread of the run

    def _solve_all(self, functions: Evaluators, start: FloatArray | None) -> abfm.Match | None:
        while True:
            with self._lock:
                problem, self._next, self._since_restart = self._next, None, 0
            if problem is None or not (self._run.is_active or self._found is None):
                return self._found
            self._history.begin()
            self._best, self._current = None, problem
            if self._found is not None:
                start = self._found.start_for(problem.parameters)
            self._found = self._solve(problem, functions, start)
            self._solved = problem

    def _solve(
        self, spec: ProblemSpec, functions: Evaluators, start: FloatArray | None
    ) -> abfm.Match:
        problem, number = spec.problem(functions), next(_numbers)

        def take(now: abfm.matching.Iteration) -> None:
            assert isinstance(now.view, IteratePicture)
            now.view.fetch = partial(self._run.process.call_now, fields, number, now.iteration)
            self._post(spec, now)

        def solve(problem: abfm.Problem) -> abfm.Match:
            task = abfm.matching.MatchTask(problem)
            return self._run.call(match, number, task, on_partial=take)

        try:
            return solve(problem.starting_from(start))
        except StartError:
            if start is None:
                raise
            return solve(problem)  # from zero, because the given field is too fast

    def _post(self, problem: ProblemSpec, now: abfm.matching.Iteration) -> None:
        view, shown, before, others = now.view, now, self.snapshot, dict[int, Any]()
        assert isinstance(view, IteratePicture)
        if view.field is not None:  # the best iterate, reported again with its fields
            self._store(Snapshot(problem, now, now))
            return
        self._history.add(now)
        if before is not None and before.problem is problem:
            is_better = view.picture is not None and better(now, before.shown)
            shown = now if is_better else before.shown
            others = {**before.others, before.iteration.attempt: before.iteration.path}
            others.pop(now.attempt, None)
        self.snapshot = Snapshot(problem, now, shown, others)
        self._since_restart += 1
        with self._lock:
            self._yield_to_next()

    def _yield_to_next(self) -> None:
        """End the solve if another problem waits, but only after some iterations.

        So matches also make progress while the user drags a slider.
        """
        if self._next is not None and self._since_restart >= _ITERATIONS_BETWEEN_RESTARTS:
            self._run.end_call()

    def _store(self, snapshot: Snapshot) -> None:
        """Store a snapshot, with its fields in this process, if it is the best of the problem."""
        is_current, best = snapshot.problem is self._current, self._best
        if is_current and (best is None or better(snapshot.shown, best.shown)):
            self._best = snapshot

    def _recovered(self, functions: Evaluators) -> abfm.Match | None:
        for snapshot in (self.snapshot if self._since_restart else None, self._best):
            with suppress(AbfmError, MemoryError):  # if the process was killed
                if snapshot is not None:
                    self._found, _ = self.unfinished(snapshot, functions)
                    self._solved = snapshot.problem
                    break
        return self._found

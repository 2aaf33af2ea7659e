"""Find the field whose flow carries one function to another: cooling stages around the optimiser, with control."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from abfm.energy import Evaluation, MatchingEnergy, check_fields
from abfm.errors import FunctionError, ParameterError
from abfm.match_result import Match
from abfm.mesh import FloatArray, TriangleMesh
from abfm.optimizer import LBFGS, State
from abfm.parameters import Parameters
from abfm.vector_fields import to_ambient, to_frame


class CancelledError(Exception):
    """Raised inside a solve that was cancelled; `match` catches it."""


class Control:
    """Pause, resume or cancel a `match` from another thread; takes effect within one evaluation of the energy."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = threading.Event()
        self._running.set()
        self._cancelled = False

    def pause(self) -> None:
        """Hold the solve before its next evaluation."""
        with self._lock:
            if not self._cancelled:  # a cancelled solve must still end
                self._running.clear()

    def resume(self) -> None:
        """Go on after `pause`."""
        self._running.set()

    def cancel(self) -> None:
        """Stop the solve; `match` returns its best iterate with the stop reason "cancelled"."""
        with self._lock:
            self._cancelled = True
            self._running.set()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._cancelled

    def wait(self) -> None:
        """Return when the solve may go on; raise `CancelledError` if it must not."""
        self._running.wait()
        if self._cancelled:
            raise CancelledError


@dataclass(frozen=True)
class Iteration:
    """What a display may want to know of one iterate.

    Attributes
    ----------
    iteration : int
        Number of steps taken, all stages together; 0 is the start.
    stage, stages : int
        Cooling stage, from 0, of how many.
    sigma : float
        Value in this stage.
    energy, regularity, mismatch_energy : float
        Total and its terms, on the mesh scaled to unit area.
    mismatch : float
        ``||f_tau - g|| / ||g||``.
    velocity : (N, F, 3) array
        The fields, in the input's units.
    advected : (V, C) array
        The source carried to tau.
    gradient_norm : float
        Norm dual to the preconditioner's.
    step_length : float
        Most that the latest step changed ``tau |v|``, as a fraction of sqrt(area).
    evaluations : int
        Evaluations of energy and gradient so far.
    """

    iteration: int
    stage: int
    stages: int
    sigma: float
    energy: float
    regularity: float
    mismatch_energy: float
    mismatch: float
    velocity: FloatArray
    advected: FloatArray
    gradient_norm: float
    step_length: float
    evaluations: int


def match(
    mesh: TriangleMesh,
    f: ArrayLike,
    g: ArrayLike,
    parameters: Parameters | None = None,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    start: ArrayLike | None = None,
    on_iteration: Callable[[Iteration], None] | None = None,
    control: Control | None = None,
) -> Match:
    """Find the tangent field whose flow carries ``f`` to ``g``.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) or (V, C) arrays
        Source and target, one or several channels.
    parameters : Parameters, optional
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative.
    weights : (C,) array, optional
        Weight of each channel's mismatch, not negative.
    start : (M, F, 3) or (F, 3) array, optional
        Fields to start from, such as an earlier ``match.velocity``, also one found for other functions or parameters;
        those of M segments are averaged over, or repeated in, the N of these parameters. Sigma is then not cooled
        again, which would lead away from a good start. Zero by default.
    on_iteration : callable, optional
        Called after every iteration, in this thread.
    control : Control, optional
        To pause, resume or cancel from elsewhere.

    Returns
    -------
    Match

    Raises
    ------
    AbfmError
        If the functions, parameters, mask, weights or start do not fit.
    """
    if not isinstance(parameters, Parameters | None):
        raise ParameterError(f"parameters is {parameters!r}; expected abfm.Parameters(...)")
    solver = _Solver(
        MatchingEnergy(mesh, f, g, parameters or Parameters(), mask, weights), on_iteration, control or Control()
    )
    best, reason = solver.run(start)
    energy = solver.energy
    return Match(
        mesh=mesh,
        source=energy.source.T.copy(),
        target=energy.target.T.copy(),
        parameters=energy.parameters,
        velocity=solver.velocity(best.x),
        advected=best.point.advected.T.copy(),
        energy_history=np.array(solver.history),
        stages=np.array(solver.stages),
        mismatch=energy.relative_mismatch(best.point.advected),
        stop_reason=reason,
        mask=energy.mask,
        weights=energy.weights,
        channels_given=np.ndim(f) == 2,
    )


class _Solver:
    """Runs the cooling stages and keeps their record."""

    def __init__(
        self, energy: MatchingEnergy, on_iteration: Callable[[Iteration], None] | None, control: Control
    ) -> None:
        self.energy = energy
        self.on_iteration = on_iteration
        self.control = control
        self.history: list[tuple[float, float, float]] = []
        self.stages: list[int] = []
        self.evaluations = 0

    def run(self, start: ArrayLike | None) -> tuple[State[Evaluation], str]:
        """The best iterate and why the solve stopped."""
        p = self.energy.parameters
        x = np.zeros(self.energy.shape)
        if start is not None:
            count = max(len(np.asarray(start)), 1) if np.ndim(start) == 3 else 1
            fields = check_fields(start, (count, *self.energy.shape[1:]), "start") / self._scale
            x = to_frame(self.energy.mesh, np.tensordot(_averages(count, p.segments), fields, 1))
        state, reason = None, "iteration limit"
        try:
            stages = list(enumerate(zip(p.stage_sigmas(), p.stage_limits(), strict=True)))
            for stage, (sigma, limit) in stages if start is None else stages[-1:]:
                search = self._search(sigma)
                current = search.init(x if state is None else state.x)
                if state is None:
                    _check_start(current.point, start is not None)
                    self._record(current, stage, sigma)
                state = current
                left = min(limit, p.iterations - len(self.history) + 1)
                while (ended := search.stop_reason(current)) is None and left > 0:
                    current = search.step(current)
                    left -= 1
                    if not current.failed:
                        state = current
                        self._record(state, stage, sigma)
                reason = ended or "iteration limit"
        except CancelledError:
            reason = "cancelled"
        assert state is not None  # the first evaluation cannot be cancelled
        return state, reason

    @property
    def _scale(self) -> float:
        return self.energy.length_scale

    def velocity(self, x: FloatArray) -> FloatArray:
        """Fields in the input's units, (N, F, 3)."""
        return to_ambient(self.energy.mesh, x) * self._scale

    def _search(self, sigma: float) -> LBFGS[Evaluation]:
        p, energy = self.energy.parameters, self.energy

        def evaluate(x: FloatArray) -> Evaluation:
            if self.evaluations:
                self.control.wait()
            self.evaluations += 1
            return energy.evaluate(x, sigma)

        def inverse(gradient: FloatArray) -> FloatArray:
            return np.stack([energy.regularizer.inverse(momentum) for momentum in gradient]) / energy.step

        def displacement(fields: FloatArray) -> float:
            return energy.step * float(np.sqrt((fields**2).sum(axis=-1)).max(axis=-1).sum())

        return LBFGS(
            evaluate,
            inverse if p.preconditioner == "hodge" else None,
            p.memory,
            displacement,
            p.max_displacement,
            p.tolerance,
        )

    def _record(self, state: State[Evaluation], stage: int, sigma: float) -> None:
        point = state.point
        self.history.append((point.energy, point.regularity, point.mismatch))
        self.stages.append(stage)
        if self.on_iteration:
            self.on_iteration(
                Iteration(
                    iteration=len(self.history) - 1,
                    stage=stage,
                    stages=self.energy.parameters.cooling_stages,
                    sigma=sigma,
                    energy=point.energy,
                    regularity=point.regularity,
                    mismatch_energy=point.mismatch,
                    mismatch=self.energy.relative_mismatch(point.advected),
                    velocity=self.velocity(state.x),
                    advected=point.advected.T.copy(),
                    gradient_norm=state.gradient_norm,
                    step_length=state.length,
                    evaluations=self.evaluations,
                )
            )


def _averages(given: int, wanted: int) -> FloatArray:
    """Weights (wanted, given) that average over even parts of a time what is constant on other even parts."""
    begins, others = np.arange(wanted)[:, None] * given, np.arange(given) * wanted
    overlaps = np.minimum(begins + given, others + wanted) - np.maximum(begins, others)
    weights: FloatArray = np.maximum(overlaps, 0) / given
    return weights


def _check_start(point: Evaluation, given: bool) -> None:
    if np.isfinite(point.energy):
        return
    if given:
        raise ParameterError("start: the flow of these fields overflows; start from slower ones or from none")
    raise FunctionError("the mismatch of source and target overflows; scale both functions down or sigma up")

"""Preconditioned L-BFGS as an iterator: `LBFGS.init`, `LBFGS.step`, `LBFGS.stop_reason` [Nocedal & Wright 2006, ch. 7]."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from abfm.kernels import inner
from abfm.line_search import HasEnergy, Trial, strong_wolfe
from abfm.mesh import FloatArray


class HasGradient(HasEnergy):
    """What the optimiser needs to know of an evaluation."""

    gradient: FloatArray


Point = TypeVar("Point", bound=HasGradient)


@dataclass(frozen=True)
class State(Generic[Point]):
    """One iterate of L-BFGS.

    Attributes
    ----------
    x : array
        The iterate; it never has a higher energy than the one before.
    point : Point
        Evaluation at ``x``.
    pairs : tuple of (s, y, 1 / <s, y>)
        Latest steps and changes of gradient, oldest first.
    gradient_norm : float
        ``sqrt(<g, H_0 g>)``, the norm dual to the preconditioner's.
    first_norm : float
        The same at the first iterate.
    length : float
        Norm of the latest step relative to the full quasi-Newton step.
    iteration, evaluations : int
        Counts since `LBFGS.init`.
    failed : bool
        The line search found no lower energy: ``x`` is the iterate before.
    """

    x: FloatArray
    point: Point
    pairs: tuple[tuple[FloatArray, FloatArray, float], ...]
    gradient_norm: float
    first_norm: float
    length: float = 0.0
    iteration: int = 0
    evaluations: int = 1
    failed: bool = False


class LBFGS(Generic[Point]):
    """Minimise an energy by L-BFGS with a strong Wolfe search.

    Parameters
    ----------
    evaluate : callable
        Array to evaluation with ``energy`` and ``gradient``; the energy may be infinite.
    precondition : callable, optional
        ``H_0``: applies a symmetric positive definite approximation of the inverse Hessian. Without it ``H_0`` is the
        usual multiple of the identity, ``<s, y> / <y, y>``.
    memory : int
        Number of pairs kept.
    size : callable, optional
        Length of a step as the user measures it.
    longest : float
        No step is longer than this in ``size``.
    tolerance : float
        Converged when the gradient's norm is this fraction of the first one.
    """

    def __init__(
        self,
        evaluate: Callable[[FloatArray], Point],
        precondition: Callable[[FloatArray], FloatArray] | None = None,
        memory: int = 10,
        size: Callable[[FloatArray], float] = lambda step: float(np.abs(step).max()),
        longest: float = np.inf,
        tolerance: float = 1e-6,
    ) -> None:
        self.evaluate = evaluate
        self.precondition = precondition
        self.memory = memory
        self.size = size
        self.longest = longest
        self.tolerance = tolerance

    def init(self, x: FloatArray) -> State[Point]:
        """Evaluate at the first iterate."""
        point = self.evaluate(x)
        norm = self._norm(point.gradient)
        return State(x, point, (), norm, norm)

    def step(self, state: State[Point]) -> State[Point]:
        """One iteration. If the search fails along the quasi-Newton direction, the memory is dropped and tried again."""
        direction = -self._inverse_hessian(state)
        slope = _inner(direction, state.point.gradient)
        if not slope < 0:
            return self._without_memory(state, 0)
        evaluations = 0

        def along(length: float) -> tuple[Point, float]:
            nonlocal evaluations
            evaluations += 1
            point = self.evaluate(state.x + length * direction)
            return point, _inner(direction, point.gradient)

        full = self.size(direction)
        longest = self.longest / full if full > 0 else 1.0
        first = 1.0 if state.pairs or self.precondition else min(1.0, 1.0 / float(np.abs(direction).sum()))
        origin = Trial(0.0, state.point.energy, slope, state.point)
        trial = strong_wolfe(along, origin, first, longest)
        if trial is None:
            return self._without_memory(state, evaluations)
        x = state.x + trial.length * direction
        return State(
            x,
            trial.point,
            self._remember(state, x, trial.point),
            self._norm(trial.point.gradient),
            state.first_norm,
            trial.length,
            state.iteration + 1,
            state.evaluations + evaluations,
        )

    def stop_reason(self, state: State[Point]) -> str | None:
        """Why to stop at this iterate, or None to go on."""
        if state.failed:
            return "line search failed"
        if state.gradient_norm <= self.tolerance * state.first_norm:
            return "converged"
        return None

    def _without_memory(self, state: State[Point], evaluations: int) -> State[Point]:
        forgetful = replace(state, pairs=(), evaluations=state.evaluations + evaluations)
        return self.step(forgetful) if state.pairs else replace(forgetful, failed=True)

    def _remember(self, state: State[Point], x: FloatArray, point: Point) -> tuple[tuple[FloatArray, FloatArray, float], ...]:
        s, y = x - state.x, point.gradient - state.point.gradient
        curvature = _inner(s, y)
        if curvature <= 1e-12 * np.sqrt(_inner(s, s) * _inner(y, y)):
            return state.pairs
        return (*state.pairs, (s, y, 1 / curvature))[-self.memory :]

    def _inverse_hessian(self, state: State[Point]) -> FloatArray:
        """Two-loop recursion, algorithm 7.4."""
        q = state.point.gradient.copy()
        weights = []
        for s, y, rho in reversed(state.pairs):
            weights.append(rho * _inner(s, q))
            q -= weights[-1] * y
        if self.precondition:
            q = self.precondition(q)
        if state.pairs:
            _, y, rho = state.pairs[-1]
            import os
            mode=os.environ.get("GAM","short")
            if mode=="short": q /= rho * _inner(y, self.precondition(y) if self.precondition else y)
            elif mode=="none": pass
            elif mode=="geo":
                sh=1/(rho*_inner(y, self.precondition(y))); q*=np.sqrt(sh)
        for (s, y, rho), weight in zip(state.pairs, reversed(weights), strict=True):
            q += (weight - rho * _inner(y, q)) * s
        return q

    def _norm(self, gradient: FloatArray) -> float:
        return float(np.sqrt(_inner(gradient, self.precondition(gradient) if self.precondition else gradient)))


def _inner(a: FloatArray, b: FloatArray) -> float:
    return float(inner(a.ravel(), b.ravel()))

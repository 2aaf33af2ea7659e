"""The action of ``exp(-t D_v)`` on functions, and its adjoint.

The exponential is a Chebyshev series on the imaginary axis, where the spectrum of ``D_v`` lies up
to small real parts: ``exp(-t D) f = sum_k c_k J_k(t rho) phi_k`` with Bessel functions ``J_k``,
``c_0 = 1``, ``c_k = 2``, ``phi_0 = f``, ``phi_1 = -(D / rho) f`` and
``phi_(k+1) = -2 (D / rho) phi_k + phi_(k-1)``. A long time is split into equal segments. The
derivative is that of the sum as computed, so it is exact whatever the truncation.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import jv

from abfm.calculus.channels import constant_part
from abfm.errors import AdvectionError
from abfm.flow import derivative_kernels, series_kernels
from abfm.flow.derivative_pattern import DerivativePattern
from abfm.flow.series_kernels import Series
from abfm.types import FloatArray

TOLERANCE = 1e-10
"""Truncation of the series where nothing else is asked for."""
# terms this much larger than the function lose five digits: split the time instead
_GROWTH_LIMIT = 1e5
_PRODUCT_LIMIT = 1e6
_SHORTEST = 2.0  # products per segment below which splitting cannot help
_SLOWEST = 1e-100  # a zero field still needs a positive rho for its derivative
_MEMORY = 70_000_000  # numbers
# products; shorter ones spend more than half on the tail
_SHORT_SEGMENT, _LONG_SEGMENT = 30.0, 1000.0


@dataclass(eq=False)
class RowProducts:
    """How many rows of ``D_v``, or of its transpose, were multiplied with functions: ``count``."""

    count: int = 0


_open_counts: list[RowProducts] = []


@contextmanager
def counted_row_products() -> Iterator[RowProducts]:
    """Count what all series and adjoints in the process cost inside the block, whatever the
    machine.

    A term of a series on V vertices is V row products, and so is one of its adjoint; not where it
    overflows.
    """
    products = RowProducts()
    _open_counts.append(products)
    try:
        yield products
    finally:
        _open_counts.remove(products)


def _count(terms: int, size: int) -> None:
    """Note a series of so many terms, of which the first is the function itself."""
    for products in _open_counts:
        products.count += max(terms - 1, 0) * size


class Workspace:
    """Memory for the terms of series, kept between evaluations: about 560 MB, and as much for
    scratch where it is full.

    The array is larger, but touched only as far as used. Beyond a million vertices one short series
    takes more.

    Parameters
    ----------
    size : int
        Rows of ``D_v``.
    """

    def __init__(self, size: int) -> None:
        self.lock = threading.Lock()
        rows = _MEMORY // size
        self.longest_segment = float(
            np.clip(2 * rows - _likely_terms(rows), _SHORT_SEGMENT, _LONG_SEGMENT)
        )
        self.block = len(_bessel_coefficients(self.longest_segment))
        self.capacity = min(rows, 8 * self.block)
        self.size = size
        self.used = self.block
        self.generation = 0

    @cached_property
    def rolling(self) -> FloatArray:
        """The last three terms of a series that keeps none, (3, size)."""
        return np.empty((3, self.size))

    @cached_property
    def terms(self) -> FloatArray:
        """The rows, (capacity and two blocks, size); none of a flow that only carries functions."""
        return np.empty((self.capacity + 2 * self.block, self.size))

    def fits(self, rows: int) -> bool:
        """Say whether so many more rows may be kept; the first block is for scratch."""
        return self.used - self.block + rows <= self.capacity

    def take(self, rows: int) -> FloatArray | None:
        """Return rows to keep until `release`, or None where there is no room."""
        return (
            self.terms[self.used : self.used + rows]
            if self.used + rows <= len(self.terms)
            else None
        )

    def release(self) -> None:
        """Forget all kept terms."""
        self.used = self.block
        self.generation += 1


def _likely_terms(x: float) -> int:
    """Return how many terms a series sums to the default tolerance unless they grow."""
    return int(x + 8 * np.cbrt(x)) + 8


def _bessel_coefficients(x: float) -> FloatArray:
    """Return ``c_k J_k(x)`` to below rounding."""
    return series_kernels.bessel_coefficients(x, int(x + 14 * np.cbrt(x)) + 20)


@dataclass
class Segment:
    """One series: its start, how many terms it summed, and these in their generation."""

    start: FloatArray
    count: int
    terms: FloatArray | None = None
    generation: int = 0


@dataclass
class Trajectory:
    """What the adjoint of an advection needs: segments of time ``step`` each, and the final
    function.

    It ends with a ``constant`` that the segments are without.
    """

    step: float
    segments: list[Segment]
    end: FloatArray
    constant: float = 0.0


class ExponentialFlow:
    """``exp(-t D_v)`` of one field.

    Parameters
    ----------
    pattern : DerivativePattern
        Of ``D_v``.
    v : (F, 2) array
        Frame coefficients of the field, in the mesh's units.
    workspace : Workspace
        Of as many rows as the pattern has.
    tolerance : float
        Where the series is truncated, relative to ``max |f|``, per segment.
    """

    def __init__(
        self,
        pattern: DerivativePattern,
        v: FloatArray,
        workspace: Workspace,
        tolerance: float = TOLERANCE,
    ) -> None:
        self.pattern = pattern
        self.workspace = workspace
        self.tolerance = tolerance
        self.values = self.pattern.values(v)
        bound = derivative_kernels.perron_bound(
            self.pattern.indptr, self.pattern.indices, self.values, 4
        )
        if not np.isfinite(bound):
            raise AdvectionError(
                "the field is not finite, or too fast for numbers: give one finite vector per face"
            )
        # Rounded up to a grid, so that the scheme, and with it the exactness of its derivative, is
        # locally constant.
        self.rho = float(2.0 ** (np.ceil(64 * np.log2(max(bound, _SLOWEST))) / 64))

    def transposed(self) -> ExponentialFlow:
        """Return the action of ``exp(-t D_v^T)``; not for clusters."""
        flow = copy(self)
        flow.values = self.pattern.transposed(self.values)
        return flow

    def forward(self, f: FloatArray, t: float) -> Trajectory:
        """Advect ``f`` (V,) over time ``t`` of either sign.

        The result is not finite where the flow itself overflows.
        """
        return self._advect(f, t, None)

    def record(self, f: FloatArray, t: float) -> Trajectory:
        """Advect as `forward`, keeping the terms that fit: `backward` computes the others again."""
        return self._advect(f, t, self.workspace)

    def _advect(self, f: FloatArray, t: float, tape: Workspace | None) -> Trajectory:
        x = abs(t) * self.rho
        if x > _PRODUCT_LIMIT:
            raise AdvectionError(
                f"advection over this time needs about {x:.0e} products with D_v (at most "
                f"{_PRODUCT_LIMIT:.0e}): shorten the time or slow the field"
            )
        count = max(1, int(np.ceil(x / self.workspace.longest_segment)))
        kept, constant = self.workspace.used, constant_part(f)  # which no flow changes
        f = f - constant if constant else f
        while (trajectory := self._attempt(f, t / count, count, tape)) is None:
            self.workspace.used = kept
            count *= 2
        trajectory.constant = constant
        trajectory.end = trajectory.end + constant if constant else trajectory.end
        return trajectory

    def _attempt(
        self, f: FloatArray, step: float, count: int, tape: Workspace | None
    ) -> Trajectory | None:
        """Compute all segments; None where terms outgrow the function: the step is too long."""
        x = abs(step) * self.rho
        coefficients = _bessel_coefficients(x)
        if tape is not None and not tape.fits(count * _likely_terms(x)):
            tape = None  # scratch serves all segments one by one
        segments: list[Segment] = []
        state = f
        for _ in range(count):
            terms = None if tape is None else tape.take(len(coefficients))
            buffer = self.workspace.rolling if terms is None else terms
            end, used, growth = self._series(state, step, coefficients, buffer)
            if (used == 0 or growth > _GROWTH_LIMIT) and x > _SHORTEST:
                return None
            if used == 0:
                return Trajectory(step, segments, np.full_like(f, np.inf))
            if terms is not None:
                self.workspace.used += used
            segments.append(Segment(state, used, terms, self.workspace.generation))
            state = end
        return Trajectory(step, segments, state)

    def _series(
        self, f: FloatArray, step: float, coefficients: FloatArray, terms: FloatArray
    ) -> tuple[FloatArray, int, float]:
        end = np.empty(self.pattern.size)
        first = int(np.ceil(abs(step) * self.rho))
        used, growth = series_kernels.chebyshev_forward(
            self._series_of(self.values, step, coefficients),
            (first, self.tolerance),
            self.pattern.restricted(f),
            terms,
            end,
        )
        _count(used, len(end))
        return self.pattern.extended(end), used, growth

    def _series_of(self, values: FloatArray, step: float, coefficients: FloatArray) -> Series:
        """Return the series of a step for ``D_v`` by its values, or for its transpose."""
        pattern, scale = self.pattern, -float(np.sign(step)) / self.rho
        return Series(pattern.indptr, pattern.indices, values, pattern.bounds, scale, coefficients)

    def backward(self, trajectory: Trajectory, mu: FloatArray, gradient: FloatArray) -> FloatArray:
        """Apply the adjoint of `forward`: adds the derivative by ``v`` to ``gradient`` (F, 2),
        returns the derivative by ``f``.

        ``mu`` (V,) is the derivative by ``trajectory.end``.
        """
        coefficients = _bessel_coefficients(abs(trajectory.step) * self.rho)
        transposed = self.pattern.transposed(self.values)
        series = self._series_of(transposed, trajectory.step, coefficients)
        entries = np.zeros_like(transposed)
        for segment in reversed(trajectory.segments):
            terms = segment.terms
            if terms is None or segment.generation != self.workspace.generation:
                terms = self.workspace.terms[: len(coefficients)]  # the scratch block
                self._series(segment.start, trajectory.step, coefficients, terms)
            _count(segment.count, self.pattern.size)
            dual = series_kernels.chebyshev_backward(
                series, terms, segment.count, self.pattern.restricted_dual(mu), entries
            )
            mu = self.pattern.extended_dual(dual)
        self.pattern.add_chain_rule(self.pattern.transposed(entries), gradient)
        return mu

    def span(self, f: FloatArray, times: FloatArray) -> FloatArray:
        """Compute ``exp(-t D_v) f`` at several times (T,) -> (T, V), of one sign and ordered away
        from zero.

        One series serves all times of a segment: only its coefficients change. Its terms go with
        the call.
        """
        trajectory = self.forward(f, float(times[-1]))
        step = trajectory.step
        out = np.repeat(trajectory.end[None], len(times), axis=0)
        owner = (
            np.clip(np.ceil(times / step) - 1, 0, len(trajectory.segments) - 1)
            if step
            else np.zeros(len(times))
        )
        coefficients = _bessel_coefficients(abs(step) * self.rho)
        terms = np.empty((len(coefficients), self.pattern.size))  # touched only as far as used
        for index, segment in enumerate(trajectory.segments):
            inside = np.flatnonzero((owner == index) & (times != times[-1]))
            if len(inside):
                self._series(segment.start, step, coefficients, terms)
                local = np.abs(times[inside] - index * step) * self.rho
                series = 2 * jv(np.arange(segment.count), local[:, None])
                series[:, 0] /= 2
                out[inside] = (series @ terms[: segment.count])[
                    :, self.pattern.rank
                ] + trajectory.constant
        return out

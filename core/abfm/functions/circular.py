"""Circular functions: values that repeat after a period are compared by their cosine and sine."""

import math
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AbfmWarning, FunctionError, ParameterError, brief
from abfm.functions.family import POSITIVE_REAL, Spec, Wrapper, choice, parameter
from abfm.functions.sides import warn_once
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray

TURN = 2 * math.pi
_PERIODS = {TURN: "2 pi", 360.0: "360"}
_RANGE_MIN = 0.95  # least range of a phase, as a fraction of its period
_JUMP_MIN = 0.9  # least difference at a jump, as a fraction of the range
_DIFFERENCE_MIN = 0.3  # least difference that counts, as a fraction of the range
_MIDDLE_MIN = 0.1  # a step has fewer vertices with values in the middle half of its range
_JUMPS_MIN = 3


@dataclass(frozen=True, kw_only=True)
class Circular(Wrapper):
    """Cosine and sine of another function, whose values repeat after a period, such as angles.

    As source and target it has two channels; ``part`` chooses one of them. It has no unit.
    """

    family = "circular"
    period: float = parameter(POSITIVE_REAL, "period after which values repeat", default=TURN)
    part: str | None = parameter(
        choice("cosine", "sine"), "one of the two functions", default=None, empty="both"
    )

    @property
    def parts(self) -> tuple[Spec, ...]:
        """The functions of the channels: cosine and sine, or only the chosen part."""
        if self.part is not None:
            return (self,)
        return tuple(replace(self, part=part) for part in ("cosine", "sine"))

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.part is None:
            raise FunctionError(
                "circular has two functions, but one is expected here. Choose part=cosine or "
                "part=sine, or use circular as source and target"
            )
        values = self.function.evaluate(mesh)
        warn_of_period(mesh, values, self.period)
        return as_circle(values, self.period)[:, 0 if self.part == "cosine" else 1]


def as_circle(values: ArrayLike, period: float = TURN) -> FloatArray:
    """Return the cosine and sine of values that repeat after ``period``, as two channels each.

    Values (..., C) of C channels become (..., 2 C); values (n,) count as one channel.
    """
    angles = TURN / period * real_numbers(values, "values", FunctionError)
    if angles.ndim == 1:
        angles = angles[:, None]
    pairs = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(pairs.reshape(*angles.shape[:-1], -1))


def checked_period(circular: Any) -> float | None:
    """Return the period in an argument ``circular``: 2 pi for True; None for False or None.

    Raises ParameterError if the argument is neither a truth value nor a positive number.
    """
    if circular is None or isinstance(circular, bool | np.bool_):
        return TURN if circular else None
    try:
        period = float(circular)
    except (TypeError, ValueError):
        period = math.nan
    if not 0 < period < math.inf:
        raise ParameterError(f"circular is {brief(circular)}; expected True or a period above 0")
    return period


def circular_frames(
    frames: ArrayLike, weights: ArrayLike | None, circular: object
) -> tuple[ArrayLike, ArrayLike | None]:
    """Convert frames to their cosine and sine if ``circular`` is True or a period.

    Frames (T, V) or (T, V, C) of a sequence become (T, V, 2 C), and weights of channels are
    repeated. Otherwise both are returned unchanged.
    """
    if (period := checked_period(circular)) is None:
        return frames, weights
    numbers = real_numbers(frames, "frames", FunctionError)
    values = as_circle(numbers[..., None] if numbers.ndim == 2 else numbers, period)
    return values, None if weights is None else np.repeat(weights, 2)


def wrapped_period(mesh: TriangleMesh, values: FloatArray) -> float | None:
    """Return the period of values (V,) that wrap around, such as angles; None for other values.

    The range of such values is 2 pi or 360, which is the period. They jump by more than 0.9 of the
    range on 3 or more edges. They jump by 0.3 to 0.9 of it on at most as many edges. Step functions
    are excluded: they have few values in the middle of the range.
    """
    is_finite = np.isfinite(values)
    if not is_finite.any():
        return None
    low, high = float(values[is_finite].min()), float(values[is_finite].max())
    size = high - low
    period = next((p for p in _PERIODS if _RANGE_MIN * p <= size <= p * (1 + 1e-6)), None)
    if period is None:
        return None
    with np.errstate(invalid="ignore"):
        differences = np.abs(np.diff(values[mesh.edges], axis=1))[:, 0] / size
        jumps = int(np.count_nonzero(differences > _JUMP_MIN))
        others = int(np.count_nonzero((differences > _DIFFERENCE_MIN) & (differences <= _JUMP_MIN)))
        middle = np.abs(values[is_finite] - (low + high) / 2) < size / 4
    is_wrapped = jumps >= max(_JUMPS_MIN, others) and middle.mean() >= _MIDDLE_MIN
    return period if is_wrapped else None


def warn_of_phases(mesh: TriangleMesh, rows: FloatArray) -> None:
    if text := phase_warning(mesh, rows):
        warnings.warn(text, AbfmWarning, stacklevel=3)


def warn_of_period(mesh: TriangleMesh, values: FloatArray, period: float) -> None:
    """Warn, once for a mesh, if values (V,) wrap around after another period than ``period``."""
    found = wrapped_period(mesh, values)
    if found is None or math.isclose(found, period, rel_tol=1e-3):
        return
    text = (
        f"values jump by about {_PERIODS[found]} between neighbours, but period is "
        f"{_PERIODS.get(period, f'{period:g}')}. Set it to the period of the values"
    )
    warn_once(mesh, text)


def phase_warning(mesh: TriangleMesh, rows: FloatArray) -> str:
    """Return a warning if some functions (C, V) seem to be phases, or an empty text."""
    periods = [period for row in rows if (period := wrapped_period(mesh, row)) is not None]
    if not periods:
        return ""
    return (
        f"values jump by about {_PERIODS[periods[0]]} between neighbours, like phases, but are "
        "compared as numbers. Set circular to compare their cosine and sine"
    )

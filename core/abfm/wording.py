"""Formatting of numbers and sentences in messages and reports."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

_SHARE_MIN = 1e-4  # smaller shares are printed as "less than 0.01%"
_SHARE_MAX = 100.0  # larger ones, of a diverging flow, are only bounded
_LOG2_MAX = 100.0  # larger factors are printed as 2 to this power


def capital(text: str) -> str:
    """Return a text with a capital first letter; other letters keep their case."""
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """Return a text as a sentence, with a capital letter and a full stop."""
    return capital(text).removesuffix(".") + "."


def counted(number: int | np.integer[Any], noun: str, plural: str = "") -> str:
    """Return a number with its noun: ``1 iteration``, ``2 iterations``.

    ``plural`` is by default the noun with a final s. It may include a verb.
    """
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def farthest_of(number: int, noun: str) -> str:
    """Return the subject of a sentence: ``landmark`` or ``farthest of 3 landmarks``."""
    return noun if number == 1 else f"farthest of {counted(number, noun)}"


def share(value: float, is_short: bool = False) -> str:
    """Return a share as text in percent: ``0.7%``, ``2.6%``, ``33%``.

    Shares are rounded up, so that a share above a bound is never printed as equal to the bound.
    If ``is_short``, "less than" is printed as "<", and "more than" as ">".
    """
    if not math.isfinite(value):
        return "an unknown share"
    if value < _SHARE_MIN:
        return f"{'<' if is_short else 'less than '}{100 * _SHARE_MIN:g}%"
    if value > _SHARE_MAX:
        return f"{'>' if is_short else 'more than '}{100 * _SHARE_MAX:,.0f}%"
    digit = 0.01 if value >= 0.1 else 0.001 if value >= 0.001 else 0.0001
    return f"{100 * digit * math.ceil(round(value / digit, 6)):.6g}%"


def number_text(value: float | None, digits: str = ".3f", unit: str = "") -> str:
    """Return a number as text in the format ``digits``, with a unit; ``-`` if it is None or NaN."""
    return "-" if value is None or math.isnan(value) else f"{value:{digits}}{unit}"


def percents(share: float | None, digits: str = ".2g") -> str:
    """Return a share as text in percent; ``-`` if it is None or NaN."""
    return "-" if share is None else number_text(100 * share, digits, "%")


def factor(log2: float) -> str:
    """Return 2 to the power ``log2`` with two significant digits: ``1.2``, ``10``, ``330``."""
    return f"{float(f'{2 ** min(log2, _LOG2_MAX):.2g}'):g}"


def value(number: float, span: float) -> str:
    """Return a number as text with three digits, or 0 below 1e-6 of ``span`` (a rounding error)."""
    return f"{0 if abs(number) < 1e-6 * span else number:.3g}"

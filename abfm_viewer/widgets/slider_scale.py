"""Where on a slider a value is, and which value a place of a slider has: linear, and logarithmic also from 0."""

import math

_ZERO_SHARE, _DECADES = 0.06, 6  # of a logarithmic slider from 0: how much of it is 0, and what the rest spans


def share_of(value: float, low: float, high: float, log: bool) -> float:
    """Where on a slider from `low` to `high` a value is, 0 to 1."""
    if not log:
        return (value - low) / (high - low)
    if low > 0:
        return math.log(value / low) / math.log(high / low)
    if value <= 0:
        return 0.0
    return _ZERO_SHARE + (1 - _ZERO_SHARE) * max(0.0, 1 + math.log10(value / high) / _DECADES)


def value_at(share: float, low: float, high: float, log: bool) -> float:
    """The value at a place of a slider: the inverse of `share_of`."""
    if not log:
        return low + share * (high - low)
    if low > 0:
        return float(low * (high / low) ** share)
    if share < _ZERO_SHARE / 2:
        return 0.0
    return float(high * 10 ** (_DECADES * (max(share, _ZERO_SHARE) - 1) / (1 - _ZERO_SHARE)))

"""Values and places of a slider: linear, and logarithmic also from 0."""

import math
from dataclasses import dataclass

# of a logarithmic slider from 0: how much of it is 0, and what the rest spans
_ZERO_SHARE, _DECADES = 0.06, 6


@dataclass(frozen=True)
class Range:
    """The ends of a slider; `whole` numbers have no digits after the point."""

    low: float
    high: float
    log: bool = False
    whole: bool = False

    def nearest(self, value: float) -> float:
        """Return a value, or the end that it is beyond."""
        return min(max(value, self.low), self.high)

    def share_of(self, value: float) -> float:
        """Return where on the slider a value is, 0 to 1."""
        if not self.log:
            return (value - self.low) / (self.high - self.low)
        if self.low > 0:
            return math.log(value / self.low) / math.log(self.high / self.low)
        if value <= 0:
            return 0.0
        decades = math.log10(value / self.high)
        return _ZERO_SHARE + (1 - _ZERO_SHARE) * max(0.0, 1 + decades / _DECADES)

    def value_at(self, share: float) -> float:
        """Return the value at a place of the slider: the inverse of `share_of`."""
        if not self.log:
            return self.low + share * (self.high - self.low)
        if self.low > 0:
            return float(self.low * (self.high / self.low) ** share)
        if share < _ZERO_SHARE / 2:
            return 0.0
        decades = _DECADES * (max(share, _ZERO_SHARE) - 1) / (1 - _ZERO_SHARE)
        return float(self.high * 10**decades)

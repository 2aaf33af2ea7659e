"""How a population is registered, and when its mean is good."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from abfm.errors import ParameterError, brief, one_line
from abfm.numerics.real_numbers import is_finite_number
from abfm.registration import initial

BOUND = 0.02
"""How much the mean may change in the last round, over its deviation, in L2."""
MOST_ROUNDS = 5
LARGEST_WEIGHT = 1e12
"""Of a subject, or a channel."""


@dataclass(frozen=True)
class Settings:
    """How subjects are registered, and when their mean is good.

    Attributes
    ----------
    functions : mapping of str
        The template's own functions, as texts, for each channel to register by: the first target.
        Without them it is the subject that is most like the plain mean.
    mask : str
        How much the template's vertices count: a function, not negative; empty for 1 everywhere.
    initial : str
        The word of the initial maps, see `abfm.register`; empty for one that is chosen.
    options : mapping
        Of each registration, as `abfm register` has them: ``alpha``, ``max-distortion``, ...
    bound : float
        The rounds end when the mean changes by less, over its deviation, in L2.
    rounds : int
        At most so many.
    weights : mapping of float
        Weights of channels to register by, other than 1: of each one's mismatch, and in how like
        the others a subject is, and how much the mean changed.
    """

    functions: Mapping[str, str] = field(default_factory=dict)
    mask: str = ""
    initial: str = ""
    options: Mapping[str, object] = field(default_factory=dict)
    bound: float = BOUND
    rounds: int = MOST_ROUNDS
    weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, weight in self.weights.items():
            if not (is_finite_number(weight) and 0 < weight <= LARGEST_WEIGHT):
                raise ParameterError(
                    f"channel {one_line(name, 60)} has weight {brief(weight)}; expected a number "
                    f"above 0, to {LARGEST_WEIGHT:g}: what is not to be registered by is held out"
                )
        if self.initial:
            initial.method_of(self.initial)
        if not (isinstance(self.rounds, int) and 1 <= self.rounds <= 1000):
            raise ParameterError(f"rounds is {brief(self.rounds)}; expected 1 to 1000")
        if not (math.isfinite(self.bound) and self.bound >= 0):
            raise ParameterError(f"bound is {brief(self.bound)}; expected a number from 0 on")

"""Settings of the registration of a population."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from abfm.errors import ParameterError, brief, one_line
from abfm.numerics.real_numbers import is_finite_number
from abfm.registration import initial

CHANGE_BOUND = 0.02  # default of `Settings.bound`
ROUNDS_DEFAULT = 5
WEIGHT_MAX = 1e12  # maximum weight of a subject or a channel


@dataclass(frozen=True)
class Settings:
    """Settings of the registrations and of the stopping criterion.

    Attributes
    ----------
    functions : mapping of str
        Functions of the template, as texts, for each channel used for registration; they are the
        first target. Without functions of the template, the first target is the subject most
        similar to the plain mean.
    mask : str
        Specification of nonnegative weights of the template's vertices; empty for 1 everywhere.
    initial : str
        Method of the initial maps, see `abfm.register`; empty for automatic choice.
    options : mapping
        Options of each registration, as for `abfm register`: ``alpha``, ``max-distortion``, ...
    bound : float
        The rounds stop when the mean changes by less than this. The change is an L2 norm, divided
        by the L2 norm of the mean minus its average over the surface.
    rounds : int
        Maximum number of rounds.
    weights : mapping of float
        Weights of channels used for registration; by default 1. A weight multiplies the mismatch of
        its channel, its part in the similarity of subjects, and its part in the change of the mean.
    """

    functions: Mapping[str, str] = field(default_factory=dict)
    mask: str = ""
    initial: str = ""
    options: Mapping[str, object] = field(default_factory=dict)
    bound: float = CHANGE_BOUND
    rounds: int = ROUNDS_DEFAULT
    weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, weight in self.weights.items():
            if not (is_finite_number(weight) and 0 < weight <= WEIGHT_MAX):
                raise ParameterError(
                    f"channel {one_line(name, 60)} has weight {brief(weight)}; expected a number "
                    f"above 0 and at most {WEIGHT_MAX:g}. To exclude a channel, name "
                    "its column held-out:NAME"
                )
        if self.initial:
            initial.method_of(self.initial)
        if not (isinstance(self.rounds, int) and 1 <= self.rounds <= 1000):
            raise ParameterError(
                f"rounds is {brief(self.rounds)}; expected an integer from 1 to 1000"
            )
        if not (math.isfinite(self.bound) and self.bound >= 0):
            raise ParameterError(f"bound is {brief(self.bound)}; expected a nonnegative number")

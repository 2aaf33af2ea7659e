"""What to try after a match, as changes of its parameters.

Time has no remedy of its own: with ``w = tau v`` the energy is ``1/tau`` times that of ``tau = 1``
with ``sigma / sqrt(tau)``, so that a larger tau is a smaller sigma.
"""

from dataclasses import dataclass, field
from typing import Any

from abfm.matching.judging import solvability
from abfm.matching.solving.resolution import narrowest
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import LARGEST_ALPHA, MANY, SMALLEST, Parameters

_USUAL = Parameters()
_FURTHER = 3.0  # how much larger or smaller a parameter is advised
_COLDER = 10.0  # the same of sigma where the source did not go to the target at all
_CARRIED = 1.5  # edges that the functions span, below which a smoother field was no truer
_LONGER = 4  # how many times as many iterations
_COURSE = (
    "order",
    "levels",
    "balance",
    "sigma",
    "sigma_unit",
    "cooling_stages",
    "cooling_factor",
    "stage_iterations",
)
"""What a search for a far target needs besides a reach, as by default."""


@dataclass(frozen=True)
class Remedy:
    """A run that is likely to come closer.

    Attributes
    ----------
    label : str
        In a word or two.
    words : str
        The same as advice, without a full stop.
    parameters : dict
        Those that change, with their new values.
    goes_on : bool
        Whether it starts from the field of the match, not from none.

    Raises
    ------
    ParameterError
        If a parameter is unknown, or its value refused.
    """

    label: str
    words: str
    parameters: dict[str, Any] = field(default_factory=dict)
    goes_on: bool = False

    def __post_init__(self) -> None:
        Parameters.from_dict(_USUAL.to_dict() | self.parameters)


class Remedies:
    """Makes remedies of a match: numbers start from the parameters it had, and from the last
    sigma.
    """

    def __init__(self, functions: FunctionTerm, parameters: Parameters, unmatched: float) -> None:
        self._functions, self._parameters = functions, parameters
        self._raised = unmatched > parameters.sigma
        self._sigma = unmatched if self._raised else parameters.sigma

    @property
    def too_far(self) -> bool:
        """Whether the target is farther away, straight through space, than the stages look."""
        return self._parameters.reach < solvability.distance(self._functions)

    @property
    def looks_near(self) -> bool:
        """Whether the stages look less far than by default; on the surface it may be farther
        than through space.
        """
        return self.too_far or self._parameters.reach < _USUAL.reach

    def go_on(self) -> Remedy:
        """The same again, from where it ended."""
        return Remedy("Continue", "go on from this field", {}, True)

    def more_time(self) -> Remedy:
        """More iterations; those of the defaults at least, as a match ends by itself."""
        count = min(max(_LONGER * self._parameters.iterations, _USUAL.iterations), MANY)
        return Remedy("More time", f"more iterations, such as {count}", {"iterations": count})

    def further(self) -> Remedy:
        """A larger reach, with the course that looks for far targets."""
        p, needed = (
            self._parameters,
            _rounded(max(solvability.distance(self._functions), _USUAL.reach)),
        )
        wanted = {name: getattr(_USUAL, name) for name in _COURSE} if not p.reach else {}
        wanted |= {"reach": needed, "iterations": max(p.iterations, _USUAL.iterations)}
        changed = {name: value for name, value in wanted.items() if value != getattr(p, name)}
        course = " and the course of the defaults" if len(changed) > 2 else ""
        return Remedy(
            "Reach further", f"a larger reach, such as {needed:g} of sqrt(area){course}", changed
        )

    def truer(self) -> Remedy | None:
        """Return what makes flow lines confirm more: parameters that stray go back to the defaults.
        None where none does.
        """
        p = self._parameters
        if self.too_far:
            return self.further()
        if p.order == 1 or p.alpha < _USUAL.alpha:
            return self._smooth()
        if self.is_warm:
            return self.colder()
        if p.alpha > _USUAL.alpha:
            words = f"a smaller alpha, such as {_USUAL.alpha:g}"
            return Remedy("Match closer", words, {"alpha": _USUAL.alpha})
        return None

    @property
    def is_carried(self) -> bool:
        """Whether the functions are wide enough on this mesh for a smoother field to be a truer
        one.
        """
        return narrowest(self._functions) >= _CARRIED

    def smoother(self) -> Remedy:
        """A larger alpha, from no motion: near the present field there is no smoother way."""
        alpha = min(_rounded(_FURTHER * self._parameters.alpha or _USUAL.alpha), LARGEST_ALPHA)
        return Remedy("Smoother", f"a larger alpha, such as {alpha:g}", {"alpha": alpha})

    def _smooth(self) -> Remedy:
        """The usual smoothness of a field in place of less."""
        p = self._parameters
        wanted = {
            "order": _USUAL.order,
            "alpha": max(p.alpha, _USUAL.alpha),
            "balance": _USUAL.balance,
        }
        changed = {name: value for name, value in wanted.items() if value != getattr(p, name)}
        told = " and ".join(f"{name} {value:g}" for name, value in changed.items())
        return Remedy("Smoother", f"a smoother field, by {told}", changed)

    def closer(self) -> Remedy:
        """A smaller sigma, from the present field."""
        sigma = max(_rounded(self._sigma / _FURTHER), SMALLEST)
        if self._raised:
            size = max(_rounded(sigma * self._functions.function_size), SMALLEST)
            words = f"an absolute sigma, which is never raised, such as {size:g}"
            return Remedy("Match closer", words, {"sigma": size, "sigma_unit": "absolute"}, True)
        return Remedy("Match closer", f"a smaller sigma, such as {sigma:g}", {"sigma": sigma}, True)

    def colder(self) -> Remedy:
        """A much smaller sigma, from no motion."""
        sigma = max(_rounded(self._sigma / _COLDER), SMALLEST)
        sigma = max(sigma, _USUAL.sigma) if self.is_warm else sigma
        return Remedy("Match closer", f"a smaller sigma, such as {sigma:g}", {"sigma": sigma})

    @property
    def is_warm(self) -> bool:
        """Whether sigma is larger than by default, so that a match is worth little."""
        return self._parameters.sigma_unit == "relative" and self._parameters.sigma > _USUAL.sigma


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")

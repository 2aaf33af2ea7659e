"""Changes of parameters that are likely to bring a match closer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from abfm.matching import solvability
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import ALPHA_MAX, COUNT_MAX, REFINE_MAX, VALUE_MIN, Parameters

_DEFAULTS = Parameters()
_FACTOR = 3.0  # how much larger or smaller a parameter is advised
_SIGMA_FACTOR = 10.0  # the same of sigma where the source did not go to the target at all
_MORE_ITERATIONS = 4  # how many times as many iterations
# what a search for a far target needs besides a reach, as by default
_CONTINUATION_NAMES = (
    "order",
    "levels",
    "sigma",
    "sigma_unit",
    "cooling_stages",
    "cooling_factor",
    "stage_iterations",
)


@dataclass(frozen=True)
class Remedy:
    """A run that is likely to come closer.

    Its ``words`` are the ``label`` as advice, its ``parameters`` those that change, checked; if it
    ``goes_on`` it starts from the field of the match, not from none.
    """

    label: str
    words: str
    parameters: dict[str, Any] = field(default_factory=dict)
    goes_on: bool = False

    def __post_init__(self) -> None:
        Parameters.of(**self.parameters)


CONTINUE_REMEDY = Remedy("Continue", "go on from this field", {}, True)


class Remedies:
    """Makes remedies of a match: numbers start from the parameters it had, and the last sigma."""

    def __init__(self, functions: FunctionTerm, parameters: Parameters, refined: int = 0) -> None:
        self._functions, self._parameters = functions, parameters
        self._refined, self._sigma = refined, parameters.last_sigma
        # larger than by default, so that a match is worth little
        relative = parameters.paper.sigma_unit == "relative"
        self.has_large_sigma = relative and parameters.last_sigma > _DEFAULTS.last_sigma

    @property
    def is_beyond_reach(self) -> bool:
        """Whether the target is farther, straight through space, than the stages reach."""
        return self._parameters.solver.reach < solvability.distance(self._functions)

    @property
    def has_small_reach(self) -> bool:
        """Whether they reach less far than by default; on the surface it may be farther."""
        return self.is_beyond_reach or self._parameters.solver.reach < _DEFAULTS.solver.reach

    def more_iterations(self) -> Remedy:
        """More iterations; those of the defaults at least, as a match ends by itself."""
        count = min(
            max(_MORE_ITERATIONS * self._parameters.solver.iterations, _DEFAULTS.solver.iterations),
            COUNT_MAX,
        )
        return Remedy("More time", f"more iterations, such as {count}", {"iterations": count})

    def larger_reach(self) -> Remedy:
        p, usual = self._parameters, _DEFAULTS.to_dict()
        needed = _rounded(max(solvability.distance(self._functions), _DEFAULTS.solver.reach))
        wanted = {name: usual[name] for name in _CONTINUATION_NAMES} if not p.solver.reach else {}
        if p.paper.sigma_unit == "relative" and p.last_sigma < _DEFAULTS.last_sigma:
            wanted.pop("sigma", None)  # which would undo a closer match
        changed = self._changes(
            wanted
            | {"reach": needed, "iterations": max(p.solver.iterations, _DEFAULTS.solver.iterations)}
        )
        course = " and the course of the defaults" if len(changed) > 2 else ""
        words = f"a larger reach, such as {needed:g} of sqrt(area){course}"
        return Remedy("Reach further", words, changed)

    def more_consistent(self) -> Remedy | None:
        """Return what makes flow lines confirm more: what strays goes back to the defaults."""
        p = self._parameters
        if self.is_beyond_reach:
            return self.larger_reach()
        if p.solver.order == 1 or p.alpha < _DEFAULTS.alpha:
            alpha = max(p.alpha, _DEFAULTS.alpha)
            changed = self._changes({"order": _DEFAULTS.solver.order, "alpha": alpha})
            values = " and ".join(f"{name} {value:g}" for name, value in changed.items())
            return Remedy("Smoother", f"a smoother field, by {values}", changed)
        return self.much_smaller_sigma() if self.has_large_sigma else None

    def finer_mesh(self) -> Remedy | None:
        """Return a finer mesh, unless it is as fine as it may be, or the course has none."""
        finer, p = self._refined + 1, self._parameters
        is_fixed = not p.solver.reach or p.paper.stage_iterations
        if finer > REFINE_MAX or is_fixed or p.paper.method == "linearised":
            return None
        return Remedy("Refine", "a finer mesh, from this field", {"refine": finer}, True)

    def larger_alpha(self) -> Remedy:
        """A larger alpha, from no motion: near the present field there is no smoother one."""
        alpha = min(_rounded(_FACTOR * self._parameters.alpha or _DEFAULTS.alpha), ALPHA_MAX)
        return Remedy("Smoother", f"a larger alpha, such as {alpha:g}", {"alpha": alpha})

    def smaller_sigma(self) -> Remedy:
        sigma = max(_rounded(self._sigma / _FACTOR), VALUE_MIN)
        return Remedy("Match closer", f"a smaller sigma, such as {sigma:g}", {"sigma": sigma}, True)

    def smaller_landmark_sigma(self) -> Remedy | None:
        """Return a smaller landmark_sigma, unless landmarks alone are matched with the usual one,
        below which they come no closer.
        """
        is_usual = self._parameters.landmark_sigma <= _DEFAULTS.landmark_sigma
        if is_usual and self._functions.is_constant:
            return None
        sigma = max(_rounded(self._parameters.landmark_sigma / _FACTOR), VALUE_MIN)
        words = f"a smaller landmark_sigma, such as {sigma:g}"
        return Remedy("Landmarks closer", words, {"landmark_sigma": sigma}, True)

    def much_smaller_sigma(self) -> Remedy:
        least = _DEFAULTS.last_sigma if self.has_large_sigma else VALUE_MIN
        sigma = max(_rounded(self._sigma / _SIGMA_FACTOR), least)
        return Remedy("Match closer", f"a smaller sigma, such as {sigma:g}", {"sigma": sigma})

    def _changes(self, wanted: dict[str, Any]) -> dict[str, Any]:
        present = self._parameters.to_dict()
        return {name: value for name, value in wanted.items() if value != present[name]}


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")

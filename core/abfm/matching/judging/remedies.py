"""Changes of parameters that are likely to reduce the residual of a match."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from abfm.matching import solvability
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import ALPHA_MAX, COUNT_MAX, REFINE_MAX, VALUE_MIN, Parameters

_DEFAULTS = Parameters()
_PARAMETER_FACTOR = 3.0  # ratio of the present and the suggested value of a parameter
_SIGMA_FACTOR = 10.0  # ratio for sigma, if the source did not move to the target
_ITERATIONS_FACTOR = 4
_LARGE_ALPHA_FACTOR = 10.0  # an alpha above this multiple of its default is reduced
# the search for a distant target needs a reach, and the defaults of these parameters
_CONTINUATION_NAMES = (
    *("order", "levels", "sigma", "sigma_unit"),
    *("cooling_stages", "cooling_factor", "stage_iterations"),
)


@dataclass(frozen=True)
class Remedy:
    """Another run that is likely to have a smaller residual.

    Attributes
    ----------
    label : str
        A short name, as on a button.
    words : str
        The advice as an imperative phrase.
    parameters : dict
        New values of the parameters that change.
    starts_from_field : bool
        Whether the run starts from the field of the match, instead of without motion.

    Raises
    ------
    ParameterError
        If a value is not allowed.
    """

    label: str
    words: str
    parameters: dict[str, Any] = field(default_factory=dict)
    starts_from_field: bool = False

    def __post_init__(self) -> None:
        Parameters.of(**self.parameters)


CONTINUE_REMEDY = Remedy("Continue", "continue from this field", {}, True)


class Remedies:
    """The changes of parameters that may improve a match."""

    def __init__(self, functions: FunctionTerm, parameters: Parameters, refined: int = 0) -> None:
        self._functions, self._parameters = functions, parameters
        self._refined, self._sigma = refined, parameters.last_sigma
        # with such a sigma, smoothness outweighs the match
        relative = parameters.paper.sigma_unit == "relative"
        self.has_large_sigma = relative and parameters.last_sigma > _DEFAULTS.last_sigma

    @property
    def is_beyond_reach(self) -> bool:
        """Whether the straight distance from source to target exceeds the parameter ``reach``."""
        return self._parameters.solver.reach < solvability.distance(self._functions)

    @property
    def has_small_reach(self) -> bool:
        """Whether the parameter ``reach`` is too small for the target, or below its default.

        Below the default it may be too small, as the distance along the surface may exceed the
        straight one.
        """
        return self.is_beyond_reach or self._parameters.solver.reach < _DEFAULTS.solver.reach

    def more_iterations(self) -> Remedy:
        """Suggest more iterations, at least the default number."""
        more = _ITERATIONS_FACTOR * self._parameters.solver.iterations
        count = min(max(more, _DEFAULTS.solver.iterations), COUNT_MAX)
        return Remedy("More time", f"use more iterations, such as {count}", {"iterations": count})

    def larger_reach(self) -> Remedy:
        """Suggest a search for the target over a larger distance."""
        p, usual = self._parameters, _DEFAULTS.to_dict()
        needed = _rounded(max(solvability.distance(self._functions), _DEFAULTS.solver.reach))
        values = {name: usual[name] for name in _CONTINUATION_NAMES} if not p.solver.reach else {}
        if p.paper.sigma_unit == "relative" and p.last_sigma < _DEFAULTS.last_sigma:
            values.pop("sigma", None)  # keep a sigma that matches more closely
        changed = self._changes(
            values
            | {"reach": needed, "iterations": max(p.solver.iterations, _DEFAULTS.solver.iterations)}
        )
        defaults = " and the default continuation" if len(changed) > 2 else ""
        words = f"use a larger reach, such as {needed:g} sqrt(area){defaults}"
        return Remedy("Reach further", words, changed)

    def more_consistent(self) -> Remedy | None:
        """Suggest a change that is likely to make discrete flow and flow lines agree, if any."""
        p = self._parameters
        if self.is_beyond_reach:
            return self.larger_reach()
        if p.solver.order == 1 or p.alpha < _DEFAULTS.alpha:
            alpha = max(p.alpha, _DEFAULTS.alpha)
            changed = self._changes({"order": _DEFAULTS.solver.order, "alpha": alpha})
            values = " and ".join(f"{name} {value:g}" for name, value in changed.items())
            return Remedy("Smoother", f"use a smoother field, with {values}", changed)
        return self.much_smaller_sigma() if self.has_large_sigma else None

    def finer_mesh(self) -> Remedy | None:
        """Suggest a finer mesh, starting from the present field.

        None if the mesh is already subdivided `REFINE_MAX` times, or if the method does not refine
        meshes.
        """
        finer, p = self._refined + 1, self._parameters
        is_fixed = not p.solver.reach or p.paper.stage_iterations
        if finer > REFINE_MAX or is_fixed or p.paper.method == "linearised":
            return None
        return Remedy(
            "Refine", "refine the mesh, starting from this field", {"refine": finer}, True
        )

    def larger_alpha(self) -> Remedy:
        """Suggest a larger alpha, without a start, as no smoother field is near the present one."""
        alpha = min(
            _rounded(_PARAMETER_FACTOR * self._parameters.alpha or _DEFAULTS.alpha), ALPHA_MAX
        )
        return Remedy("Smoother", f"use a larger alpha, such as {alpha:g}", {"alpha": alpha})

    def smaller_alpha(self) -> Remedy | None:
        """Suggest the default alpha if the present one is over ten times as large.

        The run starts without motion, because the present field may have moved the source to a
        wrong place.
        """
        alpha = _DEFAULTS.alpha
        if self._parameters.alpha <= _LARGE_ALPHA_FACTOR * alpha:
            return None
        return Remedy("Less smooth", f"use a smaller alpha, such as {alpha:g}", {"alpha": alpha})

    def smaller_sigma(self) -> Remedy:
        """Suggest a smaller sigma, starting from the present field."""
        sigma = max(_rounded(self._sigma / _PARAMETER_FACTOR), VALUE_MIN)
        words = f"use a smaller sigma, such as {sigma:g}"
        return Remedy("Match closer", words, {"sigma": sigma}, True)

    def smaller_landmark_sigma(self) -> Remedy | None:
        """Suggest a smaller landmark_sigma.

        None if only landmarks are matched and landmark_sigma is at most its default, as smaller
        values would not reduce their errors.
        """
        is_usual = self._parameters.landmark_sigma <= _DEFAULTS.landmark_sigma
        if is_usual and self._functions.is_constant:
            return None
        sigma = max(_rounded(self._parameters.landmark_sigma / _PARAMETER_FACTOR), VALUE_MIN)
        words = f"use a smaller landmark_sigma, such as {sigma:g}"
        return Remedy("Landmarks closer", words, {"landmark_sigma": sigma}, True)

    def much_smaller_sigma(self) -> Remedy:
        """Suggest a much smaller sigma, starting without motion."""
        least = _DEFAULTS.last_sigma if self.has_large_sigma else VALUE_MIN
        sigma = max(_rounded(self._sigma / _SIGMA_FACTOR), least)
        return Remedy("Match closer", f"use a smaller sigma, such as {sigma:g}", {"sigma": sigma})

    def _changes(self, values: dict[str, Any]) -> dict[str, Any]:
        present = self._parameters.to_dict()
        return {name: value for name, value in values.items() if value != present[name]}


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")

"""Parameters of a match with their checks, and Table 1 of the paper."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import Field, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple, Self, get_args, get_origin, get_type_hints

from abfm.errors import ParameterError, brief

Method = Literal["nonlinear", "linearised"]

ALPHA_MAX = 1e7
# bounds of numbers other than 0: their squares neither underflow nor overflow
VALUE_MIN = 1e-30
_VALUE_MAX = 1e30
COUNT_MAX = 1_000_000_000  # largest value of an integer parameter without another bound
LAST_SIGMA = 0.008
"""Smallest sigma of an automatic continuation, relative to the size of the functions.

With smaller values, the residual along flow lines hardly falls further for any functions.
"""
FIRST_SIGMA_MAX = 18.0
"""Largest first sigma of a continuation, in the same unit as the last sigma (see `sigma_unit`)."""
REFINE_MAX = 3
REACH_MAX = 10.0
AREA_PRESERVING_DIVERGENCE = 10.0
"""Weight of the divergence relative to the curl, for functions that match exactly.

A field that preserves areas fills the space behind a moving bump with values from its sides. A
field of large divergence stretches the value of a single point over that space.
"""
_STAGES_MAX = 1000
_ROUNDING = 1e-9

PAPER: dict[str, Any] = {
    "order": 1,
    "divergence": 1.0,
    "reach": 0.0,
    "levels": 1,
    "sigma_unit": "absolute",
    "refine": 0,
}
"""Values with which the energy and its minimisation are those of the paper."""


class Range(NamedTuple):
    """Allowed numbers of a parameter: from ``low`` to ``high``, and 0 or at least `VALUE_MIN`.

    If ``without_low``, the number ``low`` itself is not allowed.
    """

    low: float
    high: float = _VALUE_MAX
    without_low: bool = False

    def contains(self, value: float) -> bool:
        above = value > self.low if self.without_low else value >= self.low
        return above and value <= self.high and (value == 0 or value >= VALUE_MIN)

    def __str__(self) -> str:
        low = f"{'above' if self.without_low else 'of at least'} {self.low:g}"
        if self.high == COUNT_MAX:
            return low
        if self.high < COUNT_MAX or self.low:
            return f"{low} and at most {self.high:g}"
        if self.without_low:
            return f"{low} (from {VALUE_MIN:g} to {self.high:g})"
        return f"{low} and at most {self.high:g}, and of at least {VALUE_MIN:g} if it is not 0"


_HELP = {
    "tau": "end time of the flow; large deformations may need a larger value",
    "alpha": "smoothness of the field, the weight of its Hodge Laplacian; reduced automatically at "
    "small sigma",
    "beta": "weight of the gradient of the mismatch; above 0, slopes must match as well",
    "divergence": "weight of the divergence relative to the curl; 1 as in the paper, larger values "
    "preserve areas; auto: 10 for exact, 1 for measured functions",
    "sigma": "weight of the smoothness relative to the mismatch, the last of decreasing values; "
    "smaller values match more closely; auto: the closest match that passes verification",
    "landmark_sigma": "tolerance of the landmarks at the end of the continuation, as a fraction of "
    "sqrt(area); smaller values match them more closely",
    "goal": "largest residual that counts as matched, of the discrete flow and of flow lines",
    "refine": "largest number of subdivisions of a mesh that is too coarse; 0 for none; auto: "
    "chosen from its resolution",
    "order": "order of the norm of the field; 1 as in the paper, 2 for continuous fields with "
    "accurate flow",
    "reach": "distance over which the first stages compare functions, as a fraction of sqrt(area); "
    "0 as in the paper",
    "levels": "number of multigrid levels; 0 chooses from the mesh size, 1 uses only the mesh "
    "itself",
    "segments": "number of consecutive fields; 0 uses one, or two if one is not confirmed "
    "(linearised: 10)",
    "iterations": "largest number of iterations of all cooling stages together",
    "memory": "number of pairs that L-BFGS stores",
    "max_displacement": "largest change of tau |v| in one iteration, as a fraction of sqrt(area)",
    "tolerance": "fraction of the first gradient norm at which the solver has converged",
    "sigma_unit": "unit of sigma: relative to the L2 deviation of the functions from their mean, "
    "or absolute as in the paper",
    "method": "exponential flow (nonlinear), or the first two terms of the exponential "
    "(linearised)",
    "gradient": "exact derivative of the discrete energy (adjoint), or the formula of the paper "
    "(bracket)",
    "substeps": "number of sub-steps of the bracket gradient; the adjoint gradient does not depend "
    "on it",
    "quadrature": "number of intervals of the time integral in the bracket gradient",
    "cooling_stages": "number of decreasing values of sigma, including the last; 1 for no cooling, "
    "0 to choose it",
    "cooling_factor": "factor by which sigma decreases from stage to stage",
    "stage_iterations": "iterations of each stage before the last; 0 continues while the match "
    "improves (paper: half of all iterations, in equal shares)",
    "preconditioner": "exact inverse of the norm of the field (hodge), or plain L-BFGS as in the "
    "paper (none)",
}
"""A description of each parameter; "; auto: " precedes the choice that None stands for."""
_ABOVE_0 = Range(0, without_low=True)
_FROM_0 = Range(0)
_INTEGER_FROM_0 = Range(0, COUNT_MAX)


def _of(name: str, default: Any, symbol: str = "", range: Range | None = None) -> Any:
    about = {"symbol": symbol, "help": _HELP[name], "range": range}
    return field(default=default, metadata=about)


def is_integer(entry: Field[Any]) -> bool:
    """Return whether the values of a parameter are integers (or None)."""
    return str(entry.type).startswith("int")


def checked(entry: Field[Any], value: Any) -> Any:
    """Return a value of a parameter as a Python number or string, or raise ParameterError."""
    if value is None and entry.default is None:
        return None
    if choices := CHOICES.get(entry.name):
        if isinstance(value, str) and value in choices:
            return value
        expected = " or ".join(map(repr, choices))
    else:
        range: Range = entry.metadata["range"]
        kind = int if is_integer(entry) else float
        with suppress(TypeError, ValueError, OverflowError):
            number = math.nan if isinstance(value, bool) else kind(value)
            if number == value and math.isfinite(number) and range.contains(value):
                return number
        expected = f"{'an integer' if kind is int else 'a number'} {range}"
    raise ParameterError(f"{entry.name} is {brief(value)}; expected {expected}")


class Settings:
    """Base class of frozen dataclasses of parameters, which checks their values."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in FIELDS:
                object.__setattr__(self, name, checked(FIELDS[name], value))


@dataclass(frozen=True)
class SolverSettings(Settings):
    """Settings of the optimiser and of the continuation; `FIELDS` describes each of them."""

    order: int = _of("order", 2, "", Range(1, 2))
    reach: float = _of("reach", 1.0, "", Range(0, REACH_MAX))
    levels: int = _of("levels", 0, "", Range(0, 10))
    segments: int = _of("segments", 0, "N", Range(0, 1000))
    iterations: int = _of("iterations", 1000, "", _INTEGER_FROM_0)
    memory: int = _of("memory", 30, "", Range(1, 10_000))
    max_displacement: float = _of("max_displacement", 0.1, "", _ABOVE_0)
    tolerance: float = _of("tolerance", 1e-4, "", _FROM_0)


@dataclass(frozen=True)
class PaperSettings(Settings):
    """Settings that reproduce the scheme of the paper; `FIELDS` describes each of them."""

    sigma_unit: Literal["relative", "absolute"] = _of("sigma_unit", "relative")
    method: Method = _of("method", "nonlinear")
    gradient: Literal["adjoint", "bracket"] = _of("gradient", "adjoint")
    substeps: int = _of("substeps", 10, "n", Range(1, 10_000))
    quadrature: int = _of("quadrature", 10, "k", Range(1, 10_000))
    cooling_stages: int = _of("cooling_stages", 0, "*", Range(0, _STAGES_MAX))
    cooling_factor: float = _of("cooling_factor", 3.0, "*", Range(1, without_low=True))
    stage_iterations: int = _of("stage_iterations", 0, "*", _INTEGER_FROM_0)
    preconditioner: Literal["hodge", "none"] = _of("preconditioner", "hodge")


@dataclass(frozen=True)
class Parameters(Settings):
    """Parameters of a match.

    Lengths and areas refer to the mesh scaled to unit area. Each field, also of `SolverSettings`
    and `PaperSettings`, has metadata: its ``symbol`` in the paper, a ``help`` text and the `Range`
    of its numbers. A parameter whose default is None may be None, and is then chosen automatically.

    Raises
    ------
    ParameterError
        If a value is out of range, not a number, or not one of the choices.
    """

    tau: float = _of("tau", 1.0, "τ", _ABOVE_0)
    alpha: float = _of("alpha", 0.01, "α", Range(0, ALPHA_MAX))  # larger: rounding errors dominate
    beta: float = _of("beta", 0.0, "β", _FROM_0)
    divergence: float | None = _of("divergence", None, "", Range(0, ALPHA_MAX, True))
    sigma: float | None = _of("sigma", None, "σ", _ABOVE_0)
    landmark_sigma: float = _of("landmark_sigma", 0.01, "", _ABOVE_0)
    goal: float = _of("goal", 0.05, "", Range(0, 1, without_low=True))
    refine: int | None = _of("refine", None, "", Range(0, REFINE_MAX))
    solver: SolverSettings = field(default_factory=SolverSettings)
    paper: PaperSettings = field(default_factory=PaperSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, kind in NESTED.items():
            if not isinstance(value := getattr(self, name), kind):
                raise ParameterError(
                    f"{name} is {brief(value)}; expected abfm.parameters.{kind.__name__}()"
                )
        if self.solver.segments == 0 and self.paper.method == "linearised":
            object.__setattr__(self, "solver", replace(self.solver, segments=10))
        stages, factor = self.paper.cooling_stages, self.paper.cooling_factor
        try:
            first_sigma = self.stage_sigmas()[0]
        except OverflowError:
            first_sigma = math.inf
        if not first_sigma < 1e150:
            raise ParameterError(
                f"cooling_stages is {stages} and cooling_factor is {factor:g}, so the first sigma "
                "would overflow; use fewer stages or a smaller factor"
            )
        most, each = self.solver.iterations, self.paper.stage_iterations
        if most and each * (stages - 1) > most:
            raise ParameterError(
                f"stage_iterations is {each} for each of {stages - 1} stages, which exceeds the "
                f"limit of {most} iterations before the last stage; use fewer stage_iterations or "
                "more iterations"
            )

    @property
    def last_sigma(self) -> float:
        """Smallest sigma of the continuation: ``sigma``, or `LAST_SIGMA` if ``sigma`` is None."""
        return LAST_SIGMA if self.sigma is None else self.sigma

    def stage_sigmas(self) -> list[float]:
        """Return the sigma of each cooling stage.

        If ``cooling_stages`` is 0, there are as many stages as `FIRST_SIGMA_MAX` allows.
        """
        stages, factor = self.paper.cooling_stages, self.paper.cooling_factor
        if not stages:
            steps = math.log(FIRST_SIGMA_MAX / self.last_sigma, factor) + _ROUNDING
            stages = 1 + min(max(0, math.floor(steps)), _STAGES_MAX - 1)
        return [self.last_sigma * factor**power for power in reversed(range(stages))]

    def stage_limits(self) -> list[int]:
        """Return the maximum number of iterations of each stage.

        The last stage may also use the iterations that earlier stages did not need.
        """
        iterations = self.solver.iterations
        early = len(self.stage_sigmas()) - 1
        most = iterations // max(early, 1)
        return [min(self.paper.stage_iterations or most // 2, most)] * early + [iterations]

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by name in one flat dictionary."""
        found = dict(vars(self))
        for name in NESTED:
            found |= vars(found.pop(name))
        return found

    def changed(self) -> dict[str, Any]:
        """Return the parameters that differ from their defaults, by name."""
        usual = Parameters().to_dict()
        return {name: value for name, value in self.to_dict().items() if value != usual[name]}

    def with_values(self, **values: Any) -> Self:
        """Return a copy with other values of some parameters.

        The names of parameters are those in `to_dict`, so nested parameters need no prefix.

        Raises
        ------
        ParameterError
            If a name is unknown or a value is not allowed.
        """
        known = self.to_dict()
        if unknown := sorted(values.keys() - known.keys()):
            names = ", ".join(sorted(known))
            raise ParameterError(f"unknown parameter {brief(unknown[0])}; expected one of {names}")
        groups = {}
        for name, kind in NESTED.items():
            nested = [each.name for each in fields(kind) if each.name in values]
            changes = {each: values.pop(each) for each in nested}
            groups[name] = replace(getattr(self, name), **changes)
        return replace(self, **values, **groups)

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Return parameters with some values given by name; the others have their defaults.

        The names of parameters are those in `to_dict`.
        """
        return cls().with_values(**values)


NESTED = {"solver": SolverSettings, "paper": PaperSettings}
MAIN_FIELDS = {each.name: each for each in fields(Parameters) if each.name not in NESTED}
"""The dataclass fields of the main parameters, by name."""
FIELDS = MAIN_FIELDS | {each.name: each for kind in NESTED.values() for each in fields(kind)}
"""The dataclass fields of all parameters by name, in the order of `Parameters.to_dict`."""
CHOICES: dict[str, tuple[str, ...]] = {
    name: get_args(hint)
    for name, hint in get_type_hints(PaperSettings).items()
    if get_origin(hint) is Literal
}


def option(name: str) -> str:
    """Return the name of an option or column: ``max-distortion`` for ``max_distortion``."""
    return name.replace("_", "-")


def as_option(name: str, value: object) -> str:
    """Return a parameter as a command-line option: ``--sigma 0.1`` or ``--set levels=2``."""
    text = f"{value:g}" if isinstance(value, float) else "auto" if value is None else str(value)
    return f"--{option(name)} {text}" if name in MAIN_FIELDS else f"--set {name}={text}"


def in_options(advice: str) -> str:
    """Return advice with its parameters as options: ``max_distortion 1`` as ``--max-distortion 1``.

    Only parameters whose names are not common words are replaced.
    """
    names = "max_distortion", "landmark_sigma", "alpha", "sigma"
    return re.sub(rf"\b({'|'.join(names)})\b", lambda found: f"--{option(found[0])}", advice)


TITLES = {
    1: "one Gaussian becomes two distant ones",
    2: "a flow and a function advected along it",
    3: "a wide Gaussian becomes two narrow ones",
    4: "linear and exponential advection",
    5: "the smoothest field that commutes with another",
    6: "a field pushed forward along another",
    7: "eigenfunction 7 becomes eigenfunction 8",
    8: "optical flow: recover the field of a target",
    9: "a symmetry as a flow",
    10: "a symmetry as a flow, on a shape with creases",
    11: "functions with jumps become smooth ones",
    12: "a map between two poses, improved",
    13: "accuracy of the maps",
}
"""A short title of each figure."""
_PURPOSES = {
    1: "distant bumps",
    3: "bumps of other widths",
    7: "smooth waves",
    8: "recovery of a flow",
    9: "symmetric shapes",
    10: "symmetry with creases",
    11: "functions with jumps",
    12: "maps between poses",
}
"""The functions for which the parameters of a figure are suitable."""
FIGURES = tuple(TITLES)

_STAGES = 3
_FACTOR = 10.0


@dataclass(frozen=True)
class TableRow:
    """A row of Table 1.

    If ``cooled``, the sigma has a star in the table. It is then the first of three stages, each
    with a tenth of the sigma before.
    """

    figure: int
    tau: float
    alpha: float
    beta: float
    sigma: float
    cooled: bool = False
    N: int = 0
    n: int = 0

    @property
    def name(self) -> str:
        return f"Fig. {self.figure}"

    @property
    def label(self) -> str:
        """Purpose and name: ``distant bumps (Fig. 1)``."""
        return f"{_PURPOSES[self.figure]} ({self.name})"

    @property
    def about(self) -> str:
        return f"Figure {self.figure}: {TITLES[self.figure]}\n\n{NOTE}"

    @property
    def values(self) -> dict[str, Any]:
        """The parameters that the row sets, by name."""
        return {
            "tau": float(self.tau),
            "alpha": float(self.alpha),
            "beta": float(self.beta),
            "sigma": self.sigma / _FACTOR ** (_STAGES - 1) if self.cooled else self.sigma,
            "method": "linearised" if self.N else "nonlinear",
            "segments": self.N or 1,
            "cooling_stages": _STAGES if self.cooled else 1,
            "cooling_factor": _FACTOR,
            "stage_iterations": 0,
            **PAPER,
            **({"substeps": self.n} if self.n else {}),
        }

    def matches(self, parameters: Parameters) -> bool:
        return parameters.with_values(**self.values) == parameters

    def parameters(self, **others: Any) -> Parameters:
        """Return parameters with the values of the row, and other values given by name."""
        return Parameters.of(**self.values | others)


TABLE_1 = {
    row.figure: row
    for row in (
        TableRow(1, tau=1, alpha=1, beta=0, sigma=1e-2, cooled=True, n=10),
        TableRow(3, tau=2, alpha=1e3, beta=1e-5, sigma=1e-4, n=40),
        TableRow(7, tau=1, alpha=1e3, beta=0, sigma=1e-1, cooled=True, N=20),
        TableRow(8, tau=10, alpha=1e3, beta=0, sigma=1e-2, cooled=True, n=200),
        TableRow(9, tau=1, alpha=1, beta=1e-4, sigma=5e-3, n=20),
        TableRow(10, tau=1, alpha=1e3, beta=0, sigma=1e-2, cooled=True, n=20),
        TableRow(11, tau=1, alpha=1, beta=0, sigma=1e-2, cooled=True, N=10),
        TableRow(12, tau=1, alpha=1, beta=0, sigma=1e-2, cooled=True, N=10),
    )
}
"""The rows of Table 1 by figure, in its order."""

NOTE = (
    "Values of tau, alpha, beta, sigma, N and n from Table 1 of the paper. The meshes of the paper "
    "have their original size, whereas meshes here are scaled to unit area. Alpha, beta and sigma "
    "therefore have different effects. A starred sigma is the first of three cooling stages, each "
    "10 times smaller. Order, reach, levels and refine have the values of the paper. Iterations, "
    "gradient and optimiser do not change."
)
"""Note on the differences between the table and these presets."""


@lru_cache(maxsize=1)
def row_of(parameters: Parameters) -> TableRow | None:
    """Return the first row of Table 1 whose values the parameters have; None if there is none."""
    return next((row for row in TABLE_1.values() if row.matches(parameters)), None)

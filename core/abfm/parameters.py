"""What a user can set about a match, checked when it is made; and what the paper prints of that."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import Field, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple, Self, get_args, get_origin, get_type_hints

from abfm.errors import ParameterError, brief

Method = Literal["nonlinear", "linearised"]

ALPHA_MAX = 1e7
# numbers other than 0, whose squares neither underflow nor overflow
VALUE_MIN = 1e-30
_VALUE_MAX = 1e30
COUNT_MAX = 1_000_000_000
"""The most that whole numbers may be which nothing else bounds."""
LAST_SIGMA = 0.008
"""The last sigma unless one is given: flow lines confirm hardly less of any functions."""
FIRST_SIGMA_MAX = 18.0
"""The largest sigma that a path to a smaller one begins with, in the unit of that one."""
REFINE_MAX = 3
REACH_MAX = 10.0  # reach
AREA_PRESERVING_DIVERGENCE = 10.0
"""Times the curl's weight that the divergence has where functions match exactly: fields that keep
areas fill what is behind a bump with what was beside it, others with what little was there.
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
"""What makes energy and minimisation those of the paper."""


class Range(NamedTuple):
    """Numbers that a parameter takes; those that are not whole are 0 or at least 1e-30."""

    low: float
    high: float = _VALUE_MAX
    without_low: bool = False

    def contains(self, value: float) -> bool:
        """Return whether a finite number lies in the range."""
        above = value > self.low if self.without_low else value >= self.low
        return above and value <= self.high and (value == 0 or value >= VALUE_MIN)

    def __str__(self) -> str:
        low = f"{'above' if self.without_low else 'at least'} {self.low:g}"
        if self.high == COUNT_MAX:
            return low
        small = "" if self.low else f", and from {VALUE_MIN:g} on where it is not 0"
        return f"{low} and at most {self.high:g}{'' if self.high < COUNT_MAX else small}"


_HELP = """
tau: end time of the flow; large deformations may need a larger value
alpha: smoothness of the field, the weight of its Hodge Laplacian; reduced automatically if the
  match fails
beta: weight of the gradient of the mismatch; above 0, slopes must match as well
divergence: weight of the divergence relative to the curl; 1 as in the paper, larger values
  preserve areas; auto: 10 for functions that match exactly, 1 for measured functions
sigma: weight of the smoothness relative to the mismatch, at the end of the continuation; smaller
  values match more closely; auto: the closest match that passes verification
landmark_sigma: error of a landmark, as a fraction of sqrt(area), that costs as much as its
  correction, at the end of the continuation; smaller values match landmarks more closely
goal: largest residual that counts as matched, of the discrete flow and of flow lines
refine: largest number of subdivisions of a mesh that is too coarse; 0 for none; auto: chosen from
  its resolution
order: order of the norm of the field; 1 as in the paper, 2 for continuous fields with accurate flow
reach: distance over which the first stages compare functions, as a fraction of sqrt(area); 0 as in
  the paper
levels: number of multigrid levels; 0 chooses from the mesh size, 1 uses only the mesh itself
segments: number of consecutive fields; 0 uses one, or two if one is not confirmed (linearised: 10)
iterations: largest number of iterations of all cooling stages together
memory: number of pairs that L-BFGS stores
max_displacement: largest change of tau |v| in one iteration, as a fraction of sqrt(area)
tolerance: fraction of the first gradient norm at which the solver has converged
sigma_unit: unit of sigma: relative to the L2 deviation of the functions from their mean, or
  absolute as in the paper
method: exponential flow (nonlinear), or the first two terms of the exponential (linearised)
gradient: exact derivative of the discrete energy (adjoint), or the formula of the paper (bracket)
substeps: number of sub-steps of the bracket gradient; the adjoint gradient does not depend on it
quadrature: number of intervals of the time integral in the bracket gradient
cooling_stages: number of decreasing values of sigma, including the last; 1 for no cooling, 0 to
  choose it
cooling_factor: factor by which sigma decreases from stage to stage
stage_iterations: iterations of each stage before the last; 0 continues while the match improves
  (paper: half of all iterations, in equal shares)
preconditioner: exact inverse of the norm of the field (hodge), or plain L-BFGS as in the paper
  (none)
"""
_HELP_TEXTS = dict(line.split(": ", 1) for line in _HELP.replace("\n  ", " ").strip().splitlines())
_ABOVE_0 = Range(0, without_low=True)
_FROM_0 = Range(0)
_INTEGER_FROM_0 = Range(0, COUNT_MAX)


def _of(name: str, default: Any, symbol: str = "", range: Range | None = None) -> Any:
    about = {"symbol": symbol, "help": _HELP_TEXTS[name], "range": range}
    return field(default=default, metadata=about)


def is_integer(entry: Field[Any]) -> bool:
    """Return whether a parameter is a whole number, or None."""
    return str(entry.type).startswith("int")


def checked(entry: Field[Any], value: Any) -> Any:
    """Return the value of a parameter as Python's own number or text, checked alone.

    Raises
    ------
    ParameterError
        If it is out of range, not a number, or not one of the choices.
    """
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
        expected = f"{'a whole number' if kind is int else 'a number'} {range}"
    raise ParameterError(f"{entry.name} is {brief(value)}; expected {expected}")


class Settings:
    """Base of frozen dataclasses whose fields are parameters, which it checks."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in FIELDS:
                object.__setattr__(self, name, checked(FIELDS[name], value))


@dataclass(frozen=True)
class SolverSettings(Settings):
    """Settings of the minimisation and of its continuation; see `Parameters` for their fields."""

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
    """Settings that reproduce the paper's scheme; see `Parameters` for their fields."""

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
    """Parameters of a match; lengths and areas are those of the mesh scaled to unit area.

    The metadata of each field, of `SolverSettings` and `PaperSettings` as well, has its ``symbol``
    in the paper, a ``help`` text and, for numbers, their `Range`. Numbers whose default is None may
    be None: they are chosen then.

    Raises
    ------
    ParameterError
        If a value is out of range, not a number, or not one of the choices.
    """

    tau: float = _of("tau", 1.0, "τ", _ABOVE_0)
    alpha: float = _of("alpha", 0.01, "α", Range(0, ALPHA_MAX))  # beyond, rounding swamps it
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
            hottest = self.stage_sigmas()[0]
        except OverflowError:
            hottest = math.inf
        if not hottest < 1e150:
            raise ParameterError(
                f"cooling_stages is {stages} and cooling_factor {factor:g}: sigma would start "
                "beyond all numbers; use fewer stages or a smaller factor"
            )
        most, each = self.solver.iterations, self.paper.stage_iterations
        if most and each * (stages - 1) > most:
            raise ParameterError(
                f"stage_iterations is {each} for each of {stages - 1} stages; expected no more "
                f"than the {most} iterations in all, or the last stage is never reached"
            )

    @property
    def last_sigma(self) -> float:
        """Sigma as given, or `LAST_SIGMA`: where a path ends at the latest."""
        return LAST_SIGMA if self.sigma is None else self.sigma

    def stage_sigmas(self) -> list[float]:
        """Return sigma in each cooling stage, from `FIRST_SIGMA_MAX` at most if none are given."""
        stages, factor = self.paper.cooling_stages, self.paper.cooling_factor
        if not stages:
            steps = math.log(FIRST_SIGMA_MAX / self.last_sigma, factor) + _ROUNDING
            stages = 1 + min(max(0, math.floor(steps)), _STAGES_MAX - 1)
        return [self.last_sigma * factor**left for left in reversed(range(stages))]

    def stage_limits(self) -> list[int]:
        """Return iterations at most in each stage; the last also has what is left over."""
        iterations = self.solver.iterations
        early = len(self.stage_sigmas()) - 1
        most = iterations // max(early, 1)
        return [min(self.paper.stage_iterations or most // 2, most)] * early + [iterations]

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by name, nested ones among the others."""
        found = dict(vars(self))
        for name in NESTED:
            found |= vars(found.pop(name))
        return found

    def changed(self) -> dict[str, Any]:
        """Return the parameters that differ from their defaults, by name."""
        usual = Parameters().to_dict()
        return {name: value for name, value in self.to_dict().items() if value != usual[name]}

    def with_values(self, **values: Any) -> Self:
        """Return the same with other values of some parameters, by the names of `to_dict`."""
        known = self.to_dict()
        if unknown := sorted(values.keys() - known.keys()):
            names = ", ".join(sorted(known))
            raise ParameterError(f"unknown parameter {brief(unknown[0])}; expected one of {names}")
        parts = {}
        for name, kind in NESTED.items():
            own = {each.name: values.pop(each.name) for each in fields(kind) if each.name in values}
            parts[name] = replace(getattr(self, name), **own)
        return replace(self, **values, **parts)

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Return parameters by the names of `to_dict`; missing ones take their defaults."""
        return cls().with_values(**values)


NESTED = {"solver": SolverSettings, "paper": PaperSettings}
MAIN_FIELDS = {each.name: each for each in fields(Parameters) if each.name not in NESTED}
"""The declarations of the parameters that most users set."""
FIELDS = MAIN_FIELDS | {each.name: each for kind in NESTED.values() for each in fields(kind)}
"""The declarations of all parameters, by name, in the order of `Parameters.to_dict`."""
CHOICES: dict[str, tuple[str, ...]] = {
    name: get_args(hint)
    for name, hint in get_type_hints(PaperSettings).items()
    if get_origin(hint) is Literal
}


def option(name: str) -> str:
    """Return the name of an option or a column, for a name in Python."""
    return name.replace("_", "-")


def as_option(name: str, value: object) -> str:
    """Return a parameter as on the command line: ``--sigma 0.1`` or ``--set levels=2``."""
    text = f"{value:g}" if isinstance(value, float) else "auto" if value is None else str(value)
    return f"--{option(name)} {text}" if name in MAIN_FIELDS else f"--set {name}={text}"


TITLES = {
    1: "one Gaussian becomes two, a body away",
    2: "a flow and a function that it carries",
    3: "a wide Gaussian becomes two narrow ones",
    4: "linear and exponential advection",
    5: "the smoothest field that commutes with another",
    6: "a field carried along another",
    7: "eigenfunction 7 becomes eigenfunction 8",
    8: "optical flow: the field that made the target",
    9: "a symmetry as a flow",
    10: "a symmetry as a flow, on a shape with creases",
    11: "functions with jumps become smooth ones",
    12: "a map between two poses, improved",
    13: "how accurate the maps are",
}
"""A few words for each figure."""
FIGURES = tuple(TITLES)

_STAGES = 3
_FACTOR = 10.0


@dataclass(frozen=True)
class TableRow:
    """A row of Table 1; a starred sigma is `cooled`: the first of three, each a tenth."""

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
    def about(self) -> str:
        return f"{TITLES[self.figure]}\n\n{NOTE}"

    @property
    def values(self) -> dict[str, Any]:
        """The parameters that the row sets; the others stay."""
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
        """Tell whether these parameters are the row's."""
        return parameters.with_values(**self.values) == parameters

    def parameters(self, **others: Any) -> Parameters:
        """Make parameters with the row's values; `others` sets what the row leaves open."""
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
    "Table 1 of the paper: tau, alpha, beta, sigma, N and n as printed. The paper's meshes keep "
    "their own size, those here are scaled to unit area, so alpha, beta and sigma weigh "
    "differently. A starred sigma is the first of three cooling stages here, each 10 times "
    "smaller. Order, reach, levels and refine are such that the energy is the paper's; "
    "iterations, gradient and optimiser stay as they are."
)
"""What is taken over from the table, and what is not."""


@lru_cache(maxsize=1)
def row_of(parameters: Parameters) -> TableRow | None:
    """Return the first row of Table 1 that these parameters follow, if any."""
    return next((row for row in TABLE_1.values() if row.matches(parameters)), None)

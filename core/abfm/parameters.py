"""What a user can set about a match, checked when it is made."""

from __future__ import annotations

import math
from dataclasses import Field, asdict, dataclass, field, fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

from abfm.errors import ParameterError, brief

Method = Literal["nonlinear", "linearised"]

LARGEST_ALPHA = 1e7
SMALLEST, _LARGEST = 1e-30, 1e30  # numbers other than 0, whose squares neither underflow nor overflow
MANY = 1_000_000_000

PAPER: dict[str, Any] = {"order": 1, "reach": 0.0, "levels": 1, "sigma_unit": "absolute", "balance": 0.0}
"""What makes the energy and the course of its minimisation those of the paper; also what files of before had."""


def _parameter(
    default: Any, symbol: str, help: str, minimum: float | None = None, maximum: int = MANY, *, open: bool = False
) -> Any:
    metadata = {"symbol": symbol, "help": help, "minimum": minimum, "open": open, "maximum": maximum}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Parameters:
    """Parameters of a match; lengths and areas are those of the mesh scaled to unit area.

    Every field's metadata has its ``symbol`` in the paper, a ``help`` text, its ``minimum`` (excluded if ``open``) and,
    for whole numbers, its ``maximum``. Other numbers are 0 or between 1e-30 and 1e30, up to sign.

    Raises
    ------
    ParameterError
        If a value is out of range, not a number, or not one of the choices.
    """

    tau: float = _parameter(1.0, "τ", "end time of the flow; larger deformations may need more", 0, open=True)
    alpha: float = _parameter(
        0.01, "α", "smoothness of the field: weight of its Hodge Laplacian; lowered where that does not match", 0
    )
    beta: float = _parameter(0.0, "β", "weight of the mismatch's gradient: above 0, slopes must match as well", 0)
    order: int = _parameter(
        2, "", "order of the field's norm: 1, the paper's, or 2, whose fields are continuous and flow as computed", 1, 2
    )
    sigma: float = _parameter(
        0.02,
        "σ",
        "weight of the match against the smoothness: smaller matches closer; raised to what smooth flows leave",
        0,
        open=True,
    )
    sigma_unit: Literal["relative", "absolute"] = _parameter(
        "relative", "", "sigma as a fraction of the functions' deviation from their mean in L2, or as the paper has it"
    )
    reach: float = _parameter(
        1.0, "", "how far the first stages look for the target, as a fraction of sqrt(area); 0 as the paper", 0, 10
    )
    balance: float = _parameter(
        0.5, "", "weight of flow lines against the discrete advection in the end; 0 as the paper", 0, 1
    )
    levels: int = _parameter(0, "", "meshes from coarse to fine; 1 only the mesh itself, 0 by its size", 0, 10)
    method: Method = _parameter("nonlinear", "", "exponential flow, or the first two terms of the exponential")
    segments: int = _parameter(0, "N", "number of fields in a row; 0 means 1 (nonlinear) or 10 (linearised)", 0, 1000)
    gradient: Literal["adjoint", "bracket"] = _parameter(
        "adjoint", "", "exact derivative of the discrete energy, or the paper's by brackets"
    )
    substeps: int = _parameter(
        10, "n", "sub-steps of the bracket gradient (the adjoint is exact for any number)", 1, 10_000
    )
    quadrature: int = _parameter(10, "k", "intervals of the time integral in the bracket gradient", 1, 10_000)
    iterations: int = _parameter(500, "", "iterations at most, over all cooling stages together", 0)
    cooling_stages: int = _parameter(3, "*", "stages of sigma, the last one at its value; 1 for no cooling", 1, 1000)
    cooling_factor: float = _parameter(3.0, "*", "sigma is divided by this from stage to stage", 1, open=True)
    stage_iterations: int = _parameter(
        0, "*", "iterations of each stage before the last; 0: as long as they pay (paper: share half of all)", 0
    )
    preconditioner: Literal["hodge", "none"] = _parameter(
        "hodge", "", "exact inverse of the field's norm, or none (the paper's plain L-BFGS)"
    )
    memory: int = _parameter(30, "", "pairs that L-BFGS remembers", 1, 10_000)
    max_displacement: float = _parameter(
        0.1, "", "most that one iteration may change tau |v|, as a fraction of sqrt(area)", 0, open=True
    )
    tolerance: float = _parameter(1e-4, "", "converged when the gradient's norm is this fraction of its first one", 0)

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name in CHOICES:
                if not isinstance(value, str) or value not in CHOICES[entry.name]:
                    expected = " or ".join(repr(choice) for choice in CHOICES[entry.name])
                    raise ParameterError(f"{entry.name} is {brief(value)}; expected {expected}")
            else:
                object.__setattr__(self, entry.name, _checked_number(entry, value))
        if self.alpha > LARGEST_ALPHA:
            raise ParameterError(
                f"alpha is {self.alpha:g}; expected at most {LARGEST_ALPHA:g}, beyond which rounding swamps the norm"
            )
        try:
            hottest = self.stage_sigmas()[0]
        except OverflowError:
            hottest = math.inf
        if not hottest < 1e150:
            raise ParameterError(
                f"cooling_stages is {self.cooling_stages} and cooling_factor {self.cooling_factor:g}: sigma would "
                "start beyond all numbers; use fewer stages or a smaller factor"
            )
        if self.iterations and self.stage_iterations * (self.cooling_stages - 1) > self.iterations:
            raise ParameterError(
                f"stage_iterations is {self.stage_iterations} for each of {self.cooling_stages - 1} stages; expected "
                f"no more than the {self.iterations} iterations in all, or the last stage is never reached"
            )
        if self.segments == 0:
            object.__setattr__(self, "segments", 1 if self.method == "nonlinear" else 10)

    def stage_sigmas(self) -> list[float]:
        """The value of sigma in each cooling stage."""
        return [self.sigma * self.cooling_factor**left for left in reversed(range(self.cooling_stages))]

    def stage_limits(self) -> list[int]:
        """Iterations at most in each cooling stage; the last one has also what earlier ones leave over."""
        early = self.cooling_stages - 1
        share = self.stage_iterations or (self.iterations // 2 // early if early else 0)
        return [share] * early + [self.iterations]

    def to_dict(self) -> dict[str, Any]:
        """All fields as plain numbers and strings."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Parameters:
        """Inverse of `to_dict`; unknown names are refused.

        Values that name nothing of `PAPER` were written before there was anything but the paper's energy, and mean it.
        """
        known = {entry.name for entry in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise ParameterError(f"unknown parameter {brief(unknown[0])}; expected one of {', '.join(sorted(known))}")
        return cls(**(values if PAPER.keys() & values.keys() else {**PAPER, **values}))


CHOICES: dict[str, tuple[str, ...]] = {
    name: get_args(hint) for name, hint in get_type_hints(Parameters).items() if get_origin(hint) is Literal
}


def _checked_number(entry: Field[Any], value: Any) -> float:
    """The value as one of Python's own numbers."""
    name, whole = entry.name, entry.type == "int"
    minimum, open, maximum = (entry.metadata[key] for key in ("minimum", "open", "maximum"))
    kind = "a whole number" if whole else "a number"
    bound = f"{'above' if open else 'at least'} {minimum:g}"
    try:
        right_type = not isinstance(value, bool) and (int(value) == value if whole else float(value) == value)
        fits = right_type and math.isfinite(value) and (value > minimum if open else value >= minimum)
    except (TypeError, ValueError, OverflowError):
        fits = False
    if not fits:
        raise ParameterError(f"{name} is {brief(value)}; expected {kind} {bound}")
    if (whole or maximum < MANY) and value > maximum:
        raise ParameterError(f"{name} is {brief(value)}; expected {kind} {bound} and at most {maximum}")
    if not whole and value != 0 and not SMALLEST <= value <= _LARGEST:
        raise ParameterError(f"{name} is {brief(value)}; expected a number between {SMALLEST:g} and {_LARGEST:g}")
    return int(value) if whole else float(value)

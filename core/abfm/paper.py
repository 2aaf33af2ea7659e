"""What the paper prints: the titles of its figures, and the parameters of its Table 1."""

from dataclasses import dataclass
from typing import Any

from abfm.parameters import PAPER, Parameters

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

_STAGES, _FACTOR = 3, 10.0


@dataclass(frozen=True)
class Row:
    """A row of Table 1, as it is printed; a starred sigma is `cooled`."""

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
        """Name of the row in the table."""
        return f"Fig. {self.figure}"

    @property
    def values(self) -> dict[str, Any]:
        """The parameters that the row sets; the others stay.

        A starred sigma is the first one, which cooling divides by 10 from stage to stage.
        """
        substeps = {"substeps": self.n} if self.n else {}
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
            **substeps,
        }

    def holds(self, parameters: Parameters) -> bool:
        """Tell whether these parameters are the row's."""
        return all(getattr(parameters, name) == value for name, value in self.values.items())

    def parameters(self, **others: Any) -> Parameters:
        """Make parameters with the row's values; `others` sets what the row leaves open."""
        return Parameters(**{**self.values, **others})


TABLE_1 = {
    row.figure: row
    for row in (
        Row(1, tau=1, alpha=1, beta=0, sigma=1e-2, cooled=True, n=10),
        Row(3, tau=2, alpha=1e3, beta=1e-5, sigma=1e-4, n=40),
        Row(7, tau=1, alpha=1e3, beta=0, sigma=1e-1, cooled=True, N=20),
        Row(8, tau=10, alpha=1e3, beta=0, sigma=1e-2, cooled=True, n=200),
        Row(9, tau=1, alpha=1, beta=1e-4, sigma=5e-3, n=20),
        Row(10, tau=1, alpha=1e3, beta=0, sigma=1e-2, cooled=True, n=20),
        Row(11, tau=1, alpha=1, beta=0, sigma=1e-2, cooled=True, N=10),
        Row(12, tau=1, alpha=1, beta=0, sigma=1e-2, cooled=True, N=10),
    )
}
"""The rows of Table 1 by figure, in its order."""

NOTE = (
    "Table 1 of the paper: tau, alpha, beta, sigma, N and n as printed. The paper's meshes keep "
    "their own size, those here are scaled to unit area, so alpha, beta and sigma weigh "
    "differently. A starred sigma is the first of three cooling stages here, each 10 times "
    "smaller. Order, reach, levels and balance are such that the energy is the paper's; "
    "iterations, gradient and optimiser stay as they are."
)
"""What is taken over from the table, and what is not."""


def row_of(parameters: Parameters) -> Row | None:
    """Return the first row of Table 1 that these parameters follow, if any."""
    return next((row for row in TABLE_1.values() if row.holds(parameters)), None)

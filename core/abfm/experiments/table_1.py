"""Parameters of the paper's experiments, from its Table 1."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from abfm.parameters import PAPER, Parameters

_STAGES, _FACTOR = 3, 10.0


@dataclass(frozen=True)
class Row:
    """A row of Table 1.

    Attributes
    ----------
    figure : int
        The figure, as the paper numbers it.
    values : mapping of names to values
        The parameters that the row sets; the others stay.
    """

    figure: int
    values: Mapping[str, Any]

    @property
    def name(self) -> str:
        """What the table calls it."""
        return f"Fig. {self.figure}"

    def holds(self, parameters: Parameters) -> bool:
        """Whether these parameters are the row's."""
        return all(getattr(parameters, name) == value for name, value in self.values.items())

    def parameters(self, **others: Any) -> Parameters:
        """Parameters with the row's values; `others` sets what the row leaves open."""
        return Parameters(**{**self.values, **others})


def _row(
    figure: int, tau: float, alpha: float, beta: float, sigma: float, *, cooled: bool = False, N: int = 0, n: int = 0
) -> Row:
    """A row as it is printed: a starred sigma is the first one, which cooling divides by 10 from stage to stage."""
    values: dict[str, Any] = {
        "tau": float(tau),
        "alpha": float(alpha),
        "beta": float(beta),
        "sigma": sigma / _FACTOR ** (_STAGES - 1) if cooled else sigma,
        "method": "linearised" if N else "nonlinear",
        "segments": N or 1,
        "cooling_stages": _STAGES if cooled else 1,
        "cooling_factor": _FACTOR,
        "stage_iterations": 0,
        **PAPER,
    }
    return Row(figure, values | {"substeps": n} if n else values)


TABLE_1 = {
    row.figure: row
    for row in (
        _row(1, 1, 1, 0, 1e-2, cooled=True, n=10),
        _row(3, 2, 1e3, 1e-5, 1e-4, n=40),
        _row(7, 1, 1e3, 0, 1e-1, cooled=True, N=20),
        _row(8, 10, 1e3, 0, 1e-2, cooled=True, n=200),
        _row(9, 1, 1, 1e-4, 5e-3, n=20),
        _row(10, 1, 1e3, 0, 1e-2, cooled=True, n=20),
        _row(11, 1, 1, 0, 1e-2, cooled=True, N=10),
        _row(12, 1, 1, 0, 1e-2, cooled=True, N=10),
    )
}
"""The rows of Table 1 by figure, in its order."""

NOTE = (
    "Table 1 of the paper: tau, alpha, beta, sigma, N and n as printed. The paper's meshes keep their own size, those "
    "here are scaled to unit area, so alpha, beta and sigma weigh differently. A starred sigma is the first of three "
    "cooling stages here, each 10 times smaller. Order, reach, levels and balance are such that the energy is the "
    "paper's; iterations, gradient and optimiser stay as they are."
)
"""What is taken over from the table, and what is not."""


def row_of(parameters: Parameters) -> Row | None:
    """The first row of Table 1 that these parameters follow, if any."""
    return next((row for row in TABLE_1.values() if row.holds(parameters)), None)

"""What a display may want to know of one iterate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from abfm.types import FloatArray


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iterate; what it looks like on the mesh is computed when it is first asked for.

    Attributes
    ----------
    iteration, stage : int
        Number of steps taken, all stages together, 0 at the start; and which stage, from 0.
    level, levels : int
        Which mesh, from 0, the coarsest, of how many; the last one is the mesh itself. Where that has thin triangles it
        is the last but one, too, with their vertices held together, see `abfm.flow.clusters`.
    vertices : int
        Of that mesh; clusters of them where some are held together.
    reach, sigma, alpha : float
        Values in this stage.
    energy, regularity, mismatch_energy : float
        Total and its terms, on the mesh of this level scaled to unit area.
    mismatch : float
        ``||f_tau - g|| / ||g||`` on the mesh of this level.
    evaluations : int
        Evaluations of energy and gradient so far.
    """

    iteration: int
    stage: int
    level: int
    levels: int
    vertices: int
    reach: float
    sigma: float
    alpha: float
    energy: float
    regularity: float
    mismatch_energy: float
    mismatch: float
    evaluations: int
    _velocity: Callable[[], FloatArray]
    _advected: Callable[[], FloatArray]

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields, (N, F, 3), in the input's units."""
        return self._velocity()

    @cached_property
    def advected(self) -> FloatArray:
        """The source carried to tau, (V, C); on a coarser level what was carried there, interpolated."""
        return self._advected()

"""The record of a match: its stages, its iterates, and what a display may ask about each."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from abfm.calculus.vector_fields import to_ambient
from abfm.matching.solving.early_warning import early_warning
from abfm.matching.solving.incumbent import Candidate
from abfm.matching.solving.levels import Level
from abfm.matching.solving.schedule import Stage
from abfm.types import FloatArray


class Look(Protocol):
    """What an iterate looks like on the mesh itself."""

    @property
    def velocity(self) -> FloatArray:
        """The fields (N, F, 3)."""
        ...

    @property
    def advected(self) -> FloatArray:
        """The source carried to tau, (V, C)."""
        ...

    @property
    def warning(self) -> str | None:
        """What looks wrong so far, see `early_warning`."""
        ...


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iterate; what it looks like on the mesh is computed when it is first asked for."""

    iteration: int  # number of steps taken, all stages together, 0 at the start
    stage: int  # from 0
    level: int  # which mesh, from 0, the coarsest; the last one is the mesh itself
    # of how many; a mesh with thin triangles counts twice, first with their vertices held together
    levels: int
    # of that mesh; clusters of them (`abfm.flow.clusters`) where some are held together
    vertices: int
    reach: float  # values in this stage
    sigma: float
    alpha: float
    energy: float  # total and its terms, on the mesh of this level scaled to unit area
    regularity: float
    mismatch_energy: float
    mismatch: float  # ``||f_tau - g|| / ||g||`` on the mesh of this level
    evaluations: int  # of energy and gradient so far
    look: Look

    @property
    def velocity(self) -> FloatArray:
        """The fields, (N, F, 3), in the input's units."""
        return self.look.velocity

    @property
    def advected(self) -> FloatArray:
        """The source carried to tau, (V, C); on a coarser level what was carried there,
        interpolated.
        """
        return self.look.advected

    @property
    def warning(self) -> str | None:
        """What looks wrong so far, see `early_warning`."""
        return self.look.warning


class Found:
    """The look of an iterate: coefficients (N, F, 2) on the first of some levels, and the source
    carried there.
    """

    def __init__(
        self, x: FloatArray, carried: FloatArray, levels: list[Level], iteration: int
    ) -> None:
        self._x, self._carried, self._levels, self._iteration = x, carried, levels, iteration

    @cached_property
    def velocity(self) -> FloatArray:
        x, finest = self._x, self._levels[-1].energy
        for level in self._levels[:-1]:
            x = level.fields_to_finer(x)
        return to_ambient(finest.mesh, x) * finest.length_scale

    @cached_property
    def advected(self) -> FloatArray:
        functions = self._carried
        for level in self._levels[:-1]:
            functions = level.functions_to_finer(functions)
        return functions.T.copy()

    @cached_property
    def warning(self) -> str | None:
        return early_warning(self._levels[0].energy.functions, self._carried, self._iteration)


class CallerError(Exception):
    """Memory ran out in what the caller wants done after an iteration: nothing of the solver's."""

    def __init__(self, raised: MemoryError) -> None:
        self.raised = raised


class Record:
    """Keeps what a match has done, and tells of every iterate.

    ``history`` has total, regularity and mismatch of every iterate, ``stage_of`` its stage;
    ``schedule`` has the stages that were begun.
    """

    def __init__(self, on_iteration: Callable[[Iteration], None] | None) -> None:
        self.history: list[tuple[float, float, float]] = []
        self.stage_of: list[int] = []
        self.schedule: list[Stage] = []
        self.evaluations = 0
        self._on_iteration = on_iteration
        self._level = 0

    def ends_on(self, level: int) -> bool:
        """Tell whether the latest iterate is on this level."""
        return bool(self.history) and self._level == level

    def add(self, levels: list[Level], stage: Stage, best: Candidate) -> None:
        """The next iterate, on one of these levels."""
        point, self._level = best.point, stage.level
        self.history.append((point.energy, point.regularity, point.mismatch))
        self.stage_of.append(len(self.schedule) - 1)
        if self._on_iteration is None:
            return
        energy = levels[stage.level].energy
        carried = point.advected[: len(energy.functions.source)]
        self._tell(
            Iteration(
                iteration=len(self.history) - 1,
                stage=len(self.schedule) - 1,
                level=stage.level,
                levels=len(levels),
                vertices=energy.discretisation.size,
                reach=stage.reach,
                sigma=stage.sigma,
                alpha=stage.alpha,
                energy=point.energy,
                regularity=point.regularity,
                mismatch_energy=point.mismatch,
                mismatch=energy.relative_mismatch(point.advected),
                evaluations=self.evaluations,
                look=Found(best.x, carried, levels[stage.level :], len(self.history) - 1),
            )
        )

    def _tell(self, iteration: Iteration) -> None:
        assert self._on_iteration is not None
        try:
            self._on_iteration(iteration)
        except MemoryError as error:
            raise CallerError(error) from None

"""The record of a match: its stages, its iterates, and what a display may ask about each."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Protocol

from abfm.calculus.vector_fields import to_ambient
from abfm.matching.objective.matching_energy import Evaluation
from abfm.matching.path import PathStep
from abfm.matching.solvability import stood_still, vanished
from abfm.matching.solving.course import Stage
from abfm.matching.solving.levels import Level
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import mean_of_children
from abfm.outcome import RESIDUAL_NEARLY, worse_residual
from abfm.types import FloatArray

_MOVING = 10  # iterations after which whatever will move has moved


class StopReason(StrEnum):
    """Why a match stopped; what it came to is its verdict.

    As text it reads like its value: ``match.stop_reason == "cancelled"``.
    """

    CONVERGED = "converged"  # the gradient is as small as the tolerance asks, or rounding allows
    GOAL_REACHED = "goal reached"  # the residual is well below the goal
    NO_PROGRESS = "no progress"  # the energy fell too little to go on
    ITERATION_LIMIT = "iteration limit"
    LINE_SEARCH_FAILED = "line search failed"  # no step lowers the energy: often rounding
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"  # the best field that had been found is kept
    GIVEN = "given"  # the field was not sought

    @property
    def is_early(self) -> bool:
        """Tell whether it was broken off, so that going on may find more."""
        return self in (StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)


def early_warning(functions: FunctionTerm, advected: FloatArray, iteration: int) -> str | None:
    """Say what looks wrong while a match runs, in one line without a full stop; None if nothing."""
    if functions.residual(advected) <= RESIDUAL_NEARLY:
        return None
    if vanished(functions, advected):
        return (
            "the source is being squeezed to nothing instead of moved: it may be too far from the "
            "target"
        )
    if iteration >= _MOVING and stood_still(functions, advected):
        return "the source hardly moves: it may be too far from the target, or sigma too large"
    return None


class Look(Protocol):
    """What an iterate looks like on the mesh itself."""

    @property
    def velocity(self) -> FloatArray: ...
    @property
    def advected(self) -> FloatArray: ...
    @property
    def warning(self) -> str | None: ...


@dataclass(frozen=True, eq=False)
class Mark:
    """What a step of the way came to, on the mesh of its level."""

    stage: Stage
    x: FloatArray  # frame coefficients (N, F, 2)
    carried: FloatArray  # the source, (C, V)
    residual: float
    verified_residual: float = math.nan
    folded: float = math.nan
    log2_area: float = math.nan
    log2_shape: float = math.nan
    log2_area_95: float = math.nan
    held_out: float = math.nan  # residual of held-out patches, see `held_out`
    unmoved: float = math.nan  # that of the same patches without motion
    score: float = math.nan  # by which a step is chosen, see `held_out`

    def step(self, velocity: FloatArray) -> PathStep:
        """Return it for a path, with its fields (N, 4^k F, 3)."""
        return PathStep(
            self.stage.sigma,
            self.stage.alpha,
            self.stage.reach,
            velocity,
            self.residual,
            self.verified_residual,
            self.folded,
            self.log2_area,
            self.log2_shape,
            self.log2_area_95,
            self.held_out / self.unmoved if self.unmoved > 0 else math.nan,
            score=self.score,
        )

    @property
    def worse(self) -> float:
        """The larger residual of both checks."""
        return worse_residual(self.residual, self.verified_residual)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iterate; what it looks like on the mesh is computed when it is first asked for."""

    iteration: int  # number of steps taken, all stages together, 0 at the start
    stage: int  # from 0
    level: int  # which mesh, from 0, the coarsest; the last one is the mesh itself
    levels: int  # of how many; a mesh with thin triangles counts twice, first with clusters
    vertices: int  # of that mesh; clusters of them (`abfm.flow.clusters`) where there are some
    reach: float  # values in this stage
    sigma: float
    alpha: float
    energy: float  # total and its terms, on the mesh of this level scaled to unit area
    regularity: float
    mismatch_energy: float
    shares: dict[str, float]  # of that, the data terms' by their words
    residual: float  # on the mesh of this level
    evaluations: int  # of energy and gradient so far
    look: Look
    path: tuple[PathStep, ...] = ()  # the steps of this way so far, whose fields come at the end
    fields: int = 1  # in a row, N

    @property
    def velocity(self) -> FloatArray:
        """The fields, (N, F, 3), in the input's units."""
        return self.look.velocity

    @property
    def advected(self) -> FloatArray:
        """The source carried to tau, (V, C); on a coarser level what is so there, interpolated."""
        return self.look.advected

    @property
    def warning(self) -> str | None:
        """What looks wrong so far, in one line; None if nothing."""
        return self.look.warning


@dataclass(frozen=True, eq=False)
class Found:
    x: FloatArray  # frame coefficients (N, F, 2)
    carried: FloatArray  # the source, (C, V)
    levels: list[Level]  # from its own to that of the mesh itself, or that of a finer one alone
    mesh: TriangleMesh  # itself, of area 1
    iteration: int
    is_trying: bool  # whether there are other ways or smaller sigmas to try

    @cached_property
    def velocity(self) -> FloatArray:
        x, finest = self.x, self.levels[-1].energy
        for level in self.levels[:-1]:
            x = level.fields_to_finer(x)
        fields = to_ambient(finest.mesh, x) * finest.length_scale
        return mean_of_children(fields, len(self.mesh.faces))

    @cached_property
    def advected(self) -> FloatArray:
        functions = self.carried
        for level in self.levels[:-1]:
            functions = level.functions_to_finer(functions)
        return functions[:, : len(self.mesh.vertices)].T.copy()

    @cached_property
    def warning(self) -> str | None:
        if self.is_trying:
            return None
        return early_warning(self.levels[0].energy.functions, self.carried, self.iteration)


class CallerError(Exception):
    """Memory ran out in what the caller wants done after an iteration: nothing of the solver's."""

    def __init__(self, raised: MemoryError) -> None:
        self.raised = raised


class Record:
    def __init__(self, on_iteration: Callable[[Iteration], object] | None) -> None:
        self.history: list[tuple[float, float, float]] = []
        self.stage_of: list[int] = []
        self.schedule: list[Stage] = []
        self.evaluations = 0
        self.level: int | None = None  # of the latest iterate
        self.path: tuple[PathStep, ...] = ()  # the steps of the present way so far
        self.is_trying = False  # whether there is more to try
        self._on_iteration = on_iteration

    def add(self, levels: list[Level], own: int, stage: Stage, point: Evaluation) -> None:
        self.level = stage.level
        self.history.append((point.energy, point.regularity, point.mismatch))
        self.stage_of.append(len(self.schedule) - 1)
        if self._on_iteration is None:
            return
        energy, number = levels[stage.level].energy, len(self.history) - 1
        carried = point.advected[: len(energy.functions.source)]
        shares: dict[str, float] = {}
        for word, share in zip(energy.words, point.shares, strict=True):
            shares[word] = shares.get(word, 0.0) + share
        between = levels[stage.level : max(own, stage.level) + 1]
        iteration = Iteration(
            iteration=number,
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
            shares=shares,
            residual=energy.left(point),
            evaluations=self.evaluations,
            look=Found(point.x, carried, between, levels[own].energy.mesh, number, self.is_trying),
            path=self.path,
            fields=len(point.x),
        )
        try:
            self._on_iteration(iteration)
        except MemoryError as error:
            raise CallerError(error) from None

"""The record of a match: its stages and iterates, and the results of its steps."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any, NamedTuple, Protocol

from abfm.calculus.vector_fields import to_ambient
from abfm.matching.objective.matching_energy import Evaluation
from abfm.matching.path import PathStep
from abfm.matching.solvability import stood_still, vanished
from abfm.matching.solving.levels import Level, Levels
from abfm.matching.solving.schedule import Stage
from abfm.matching.solving.settings import SETTINGS
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import mean_of_children
from abfm.outcome import RESIDUAL_NEARLY, worse_residual
from abfm.types import FloatArray


class StopReason(StrEnum):
    """Why a match stopped; what it achieved is its verdict.

    As text it reads like its value: ``match.stop_reason == "cancelled"``.
    """

    CONVERGED = "converged"  # the gradient is within the tolerance, or within rounding
    GOAL_REACHED = "goal reached"  # the residual is well below the goal
    NO_PROGRESS = "no progress"  # the energy fell too little to continue
    ITERATION_LIMIT = "iteration limit"
    LINE_SEARCH_FAILED = "line search failed"  # no step lowers the energy: often rounding
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"  # the best field so far is the result
    GIVEN = "given"  # the field was not solved for

    @property
    def is_interrupted(self) -> bool:
        """Whether it was interrupted, so that more iterations may find more."""
        return self in (StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)


def early_warning(functions: FunctionTerm, advected: FloatArray, iteration: int) -> str | None:
    """Return a warning while a match runs, in one line without a full stop; None if there is
    none.
    """
    if functions.residual(advected) <= RESIDUAL_NEARLY:
        return None
    if vanished(functions, advected):
        return (
            "the source is being squeezed to nothing instead of moved: it may be too far from the "
            "target"
        )
    if iteration >= SETTINGS.warning_iterations_min and stood_still(functions, advected):
        return "the source hardly moves: it may be too far from the target, or sigma too large"
    return None


class View(Protocol):
    """An iterate on the mesh itself."""

    @property
    def velocity(self) -> FloatArray: ...
    @property
    def advected(self) -> FloatArray: ...
    @property
    def warning(self) -> str | None: ...


class Score(NamedTuple):
    """The score of a step by held-out patches, see `held_out`; NaN if nothing is held out."""

    value: float = math.nan  # by which a step is chosen
    held_out: float = math.nan  # residual of the patches
    unmoved: float = math.nan  # their residual without motion

    @property
    def gain(self) -> float:
        """The residual relative to that without motion."""
        return self.held_out / self.unmoved if self.unmoved > 0 else math.nan


@dataclass(frozen=True, eq=False)
class StepResult:
    """The result of a step of the path, on the mesh of its level."""

    stage: Stage
    x: FloatArray  # frame coefficients (N, F, 2)
    carried: FloatArray  # the advected functions of all terms, (C, V)
    residual: float
    measures: Mapping[str, float] = field(default_factory=dict)  # along flow lines, see `measured`
    score: Score = Score()

    def step(self, velocity: FloatArray, mismatch: float = math.nan) -> PathStep:
        """Return the step of a path with these fields (N, 4^k F, 3)."""
        return PathStep(
            self.stage.sigma,
            self.stage.alpha,
            self.stage.reach,
            velocity,
            self.residual,
            **self.measures,
            held_out=self.score.gain,
            score=self.score.value,
            mismatch=mismatch,
        )

    @property
    def verified_residual(self) -> float:
        """The residual along flow lines; NaN if it is unknown."""
        return self.measures.get("verified_residual", math.nan)

    @property
    def worse(self) -> float:
        """The larger residual of both checks."""
        return worse_residual(self.residual, self.verified_residual)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iterate; its fields and functions on the mesh are computed at their first use."""

    iteration: int  # number of iterations of all stages so far, 0 at the start
    stage: int  # from 0
    level: int  # number of the mesh, from 0, the coarsest; the last one is the mesh itself
    levels: int  # their number; a mesh with thin triangles counts twice, first with clusters
    vertices: int  # of the level's mesh; clusters of them (`abfm.flow.clusters`) if it has some
    reach: float  # values in this stage
    sigma: float
    alpha: float
    energy: float  # total and its terms, on the mesh of this level scaled to unit area
    regularity: float
    mismatch_energy: float
    shares: dict[str, float]  # of that, the data terms' by their names
    residual: float  # on the mesh of this level
    evaluations: int  # of energy and gradient so far
    view: View
    path: tuple[PathStep, ...] = ()  # the steps so far, still without fields
    fields: int = 1  # number of consecutive fields, N

    @property
    def velocity(self) -> FloatArray:
        """The fields, (N, F, 3), in the input's units."""
        return self.view.velocity

    @property
    def advected(self) -> FloatArray:
        """The advected source, (V, C); interpolated from a coarser level."""
        return self.view.advected

    @property
    def warning(self) -> str | None:
        """A warning so far, in one line; None if there is none."""
        return self.view.warning


@dataclass(frozen=True, eq=False)
class IterateView:
    """An iterate of some level on the mesh itself."""

    x: FloatArray  # frame coefficients (N, F, 2)
    carried: FloatArray  # the advected source, (C, V)
    levels: tuple[Level, ...]  # from that of the iterate to the mesh itself; a finer one alone
    mesh: TriangleMesh  # itself, of area 1
    iteration: int
    is_trying: bool  # whether other variants or smaller sigmas follow

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


class Record:
    """The log of a match, which a callback receives."""

    def __init__(self, on_iteration: Callable[[Iteration], object] | None) -> None:
        self.history: list[tuple[float, float, float]] = []
        self.stage_of: list[int] = []
        self.schedule: list[Stage] = []
        self.evaluations = 0
        # level and evaluation of the latest fields of the present variant
        self.latest: tuple[int, Evaluation] | None = None
        self.learned: Any = None  # the latest iterate of a search, whose pairs hold the curvature
        self.path: tuple[PathStep, ...] = ()  # the steps of the present variant so far
        self.is_trying = False  # whether other variants or smaller sigmas follow
        self.is_calling = False  # whether the callback runs, or has raised an error
        self._level: int | None = None  # of the latest iterate
        self._on_iteration = on_iteration

    def begin(self) -> None:
        """Forget the latest fields, and the curvature: a variant begins."""
        self.latest = self.learned = None

    def count(self) -> None:
        """Count an evaluation."""
        self.evaluations += 1

    def arrive(self, levels: Levels, stage: Stage, point: Evaluation) -> None:
        """Note the first fields of a stage, which are an iterate if a level begins."""
        self.latest = stage.level, point
        iterations, is_new = len(self.history), self._level != stage.level
        if not iterations or (
            is_new and iterations <= levels[-1].energy.parameters.solver.iterations
        ):
            self.add(levels, stage, point)

    def add(self, levels: Levels, stage: Stage, point: Evaluation) -> None:
        """Add an iterate."""
        self.latest, self._level = (stage.level, point), stage.level
        self.history.append((point.energy, point.regularity, point.mismatch))
        self.stage_of.append(len(self.schedule) - 1)
        if self._on_iteration is not None:
            iteration = self._iteration(levels, stage, point)
            self.is_calling = True
            self._on_iteration(iteration)
            self.is_calling = False

    def _iteration(self, levels: Levels, stage: Stage, point: Evaluation) -> Iteration:
        energy, number = levels[stage.level].energy, len(self.history) - 1
        carried = point.advected[: len(energy.functions.source)]
        shares: dict[str, float] = {}
        for word, share in zip(energy.words, point.shares, strict=True):
            shares[word] = shares.get(word, 0.0) + share
        between = levels.all[stage.level : max(levels.mesh_level, stage.level) + 1]
        mesh = levels[levels.mesh_level].energy.mesh
        return Iteration(
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
            view=IterateView(point.x, carried, between, mesh, number, self.is_trying),
            path=self.path,
            fields=len(point.x),
        )

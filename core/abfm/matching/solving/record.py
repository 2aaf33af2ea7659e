"""The record of a match: stages, iterates and results of steps."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any, NamedTuple, Protocol

from abfm.calculus.vector_fields import to_ambient
from abfm.matching.objective.matching_energy import Evaluation
from abfm.matching.path import PathStep
from abfm.matching.solvability import hardly_moved, vanished
from abfm.matching.solving.levels import Level, Levels
from abfm.matching.solving.outlook import Outlook
from abfm.matching.solving.schedule import Stage
from abfm.matching.solving.settings import SETTINGS
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import mean_of_children
from abfm.outcome import RESIDUAL_NEARLY, worse_residual
from abfm.types import FloatArray


class StopReason(StrEnum):
    """The reason why the solver of a match stopped; it does not state how good the match is.

    Members are strings: ``match.stop_reason == "cancelled"``.
    """

    CONVERGED = "converged"  # the gradient is within the tolerance or rounding errors
    GOAL_REACHED = "goal reached"  # the residual is well below the goal
    NO_PROGRESS = "no progress"  # the energy fell too little
    ITERATION_LIMIT = "iteration limit"
    LINE_SEARCH_FAILED = "line search failed"  # rounding errors are a usual cause
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"  # the best field so far is the result
    GIVEN = "given"  # the field was given, not computed

    @property
    def is_interrupted(self) -> bool:
        """Whether the run was interrupted, so that more iterations may improve the match."""
        return self in (StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)


def early_warning(functions: FunctionTerm, advected: FloatArray, iteration: int) -> str | None:
    """Return a warning if the source of a running match vanishes or hardly moves, or None."""
    if functions.residual(advected) <= RESIDUAL_NEARLY:
        return None
    if vanished(functions, advected):
        return (
            "the source is being squeezed to nothing instead of moving: it may be too far from the "
            "target"
        )
    if iteration >= SETTINGS.warning_iterations_min and hardly_moved(functions, advected):
        return "the source hardly moves: it may be too far from the target, or sigma too large"
    return None


class View(Protocol):
    """Fields and advected functions of an iterate, transferred to the mesh of the problem."""

    @property
    def velocity(self) -> FloatArray: ...
    @property
    def advected(self) -> FloatArray: ...
    @property
    def warning(self) -> str | None: ...


class Score(NamedTuple):
    """The cross-validation score of a step, see `held_out`; NaN if no patches were held out."""

    value: float = math.nan  # smaller is better
    held_out: float = math.nan  # residual of the held-out patches
    unmoved: float = math.nan  # residual of the held-out patches without motion

    @property
    def gain(self) -> float:
        """The residual of held-out patches, relative to their residual without motion."""
        return self.held_out / self.unmoved if self.unmoved > 0 else math.nan


@dataclass(frozen=True, eq=False)
class StepResult:
    """The result of one step of the continuation, on the mesh where it was computed."""

    stage: Stage
    x: FloatArray  # frame coefficients (N, F, 2)
    advected: FloatArray  # the advected functions of all terms, (C, V)
    residual: float
    measures: Mapping[str, float] = field(default_factory=dict)  # numbers of `flow_line_measures`
    score: Score = Score()

    def step(self, velocity: FloatArray, mismatch: float = math.nan) -> PathStep:
        """Return this result as a `PathStep` with the fields ``velocity`` (N, 4^k F, 3)."""
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
        return self.measures.get("verified_residual", math.nan)

    @property
    def worse(self) -> float:
        return worse_residual(self.residual, self.verified_residual)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iterate of the solver; its fields and functions are computed at the first use."""

    iteration: int  # total number of iterations so far, 0 at the start
    stage: int  # number of the stage, from 0
    level: int  # number of the mesh, from 0 for the coarsest one
    levels: int  # number of levels; a mesh with thin triangles counts twice, first with clusters
    vertices: int  # number of vertices of the level, or of clusters (`abfm.flow.clusters`)
    reach: float  # reach of this stage
    sigma: float
    alpha: float
    energy: float  # total energy on the mesh of this level, scaled to unit area
    regularity: float
    mismatch_energy: float
    term_energies: dict[str, float]  # parts of the mismatch energy by name of the data term
    residual: float  # residual on the mesh of this level
    evaluations: int  # number of evaluations of the energy so far
    view: View
    path: tuple[PathStep, ...] = ()  # the steps so far, without fields
    fields: int = 1  # number of consecutive fields, N
    is_of_landmarks: bool = False  # whether only landmarks are matched
    # number of the attempt, from 1, and largest number of attempts: the variants of the search
    attempt: int = 1
    attempts: int = 1

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
        """A warning about the run so far, in one line, or None."""
        return self.view.warning


@dataclass(frozen=True, eq=False)
class IterateView:
    """Fields and functions of an iterate on any level, transferred to the mesh of the problem."""

    x: FloatArray  # frame coefficients (N, F, 2)
    level_advected: FloatArray  # the advected source on the mesh of the level, (C, V)
    levels: tuple[Level, ...]  # from the level of the iterate to that of ``mesh``
    mesh: TriangleMesh  # the mesh of the problem, scaled to unit area
    iteration: int
    is_provisional: bool  # whether other variants or smaller sigmas follow

    @cached_property
    def velocity(self) -> FloatArray:
        x, finest = self.x, self.levels[-1].energy
        for level in self.levels[:-1]:
            x = level.fields_to_finer(x)
        fields = to_ambient(finest.mesh, x) * finest.length_scale
        return mean_of_children(fields, len(self.mesh.faces))

    @cached_property
    def advected(self) -> FloatArray:
        functions = self.level_advected
        for level in self.levels[:-1]:
            functions = level.functions_to_finer(functions)
        return functions[:, : len(self.mesh.vertices)].T.copy()

    @cached_property
    def warning(self) -> str | None:
        if self.is_provisional:
            return None
        return early_warning(self.levels[0].energy.functions, self.level_advected, self.iteration)


class Record:
    """The history of a match; each iterate is passed to a callback."""

    def __init__(self, on_iteration: Callable[[Iteration], object] | None) -> None:
        self.history: list[tuple[float, float, float]] = []
        self.stage_of: list[int] = []
        self.schedule: list[Stage] = []
        self.evaluations = 0
        # level and evaluation of the latest fields of this variant
        self.latest: tuple[int, Evaluation] | None = None
        self.last_iterate: Any = None  # has the L-BFGS pairs of the search
        self.path: tuple[PathStep, ...] = ()  # the steps of this variant so far
        self.is_provisional = False  # see `IterateView`
        self.is_calling = False  # whether the callback runs, or has raised an error
        self.attempt = self.attempts = 1  # see `Iteration`
        self.outlook: Outlook | None = None
        self._level: int | None = None  # level of the latest iterate
        self._on_iteration = on_iteration

    def begin(self, attempt: int, attempts: int) -> None:
        self.latest, self.last_iterate, self.path = None, None, ()
        self.attempt, self.attempts = attempt, attempts

    def count(self) -> None:
        self.evaluations += 1

    def begin_stage(self, levels: Levels, stage: Stage, point: Evaluation) -> None:
        """Record the first fields of a stage; if its level is new, they count as an iterate."""
        self.latest = stage.level, point
        iterations, limit = len(self.history), levels[-1].energy.parameters.solver.iterations
        if not iterations or (self._level != stage.level and iterations <= limit):
            self.add(levels, stage, point)

    def add(self, levels: Levels, stage: Stage, point: Evaluation) -> None:
        self.latest, self._level = (stage.level, point), stage.level
        self.history.append((point.energy, point.regularity, point.mismatch))
        self.stage_of.append(len(self.schedule) - 1)
        if self.outlook is not None:
            self.outlook.add(levels[stage.level].energy.discretisation.size)
        if self._on_iteration is not None:
            iteration = self._iteration(levels, stage, point)
            self.is_calling = True
            self._on_iteration(iteration)
            self.is_calling = False

    def _iteration(self, levels: Levels, stage: Stage, point: Evaluation) -> Iteration:
        energy, number = levels[stage.level].energy, len(self.history) - 1
        advected = point.advected[: len(energy.functions.source)]
        energies: dict[str, float] = {}
        for name, part in zip(energy.term_names, point.term_energies, strict=True):
            energies[name] = energies.get(name, 0.0) + part
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
            term_energies=energies,
            residual=energy.residual_at(point),
            evaluations=self.evaluations,
            view=IterateView(point.x, advected, between, mesh, number, self.is_provisional),
            path=self.path,
            fields=len(point.x),
            is_of_landmarks=energy.is_of_landmarks,
            attempt=self.attempt,
            attempts=self.attempts,
        )

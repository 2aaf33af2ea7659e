"""The result of a match: a field, and all that its flow carries."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.display import Display
from abfm.errors import AbfmError, one_line
from abfm.flow.flow import Flow
from abfm.io import results
from abfm.maps.distortion import Bound, Distortion
from abfm.maps.point_maps import PointMap
from abfm.matching.judging.cause import Cause
from abfm.matching.judging.facts import Report
from abfm.matching.judging.remedies import Remedy
from abfm.matching.judging.verdict import Evidence, Verdict, judge
from abfm.matching.judging.verification import Verification, verify
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.path import PathStep, choice_text, path_arrays, path_of
from abfm.matching.problem import Problem, problem_of
from abfm.matching.solving.measures import flow_line_measures
from abfm.matching.solving.record import StopReason
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import mean_of_children, times_subdivided
from abfm.outcome import Facts, Outcome, outcome_of, worse_residual
from abfm.parameters import Parameters
from abfm.reading import from_json
from abfm.types import File, FloatArray, IntArray

_RESIDUAL_DIFFERENCE = 0.005
"""Difference up to which the residual of a file agrees with that of its field: a tenth of the usual
goal, where rounding is 1e-6 of it."""
_RESIDUAL_SHARE = 0.05
"""The same, of the residual."""


@dataclass(frozen=True, eq=False)
class Match(Display):
    """A field whose flow carries the source towards the target.

    Attributes
    ----------
    problem : Problem
        The problem that it solves.
    fine_velocity : (N, 4^k F, 3) array
        Tangent fields, in the input's length unit per unit of time, on the mesh or on its midpoint
        subdivision made k times.
    advected : (V, C) array
        The source, advected to tau.
    energy_history : (iterations + 1, 3) array
        Total, regularity and mismatch, in the solver's units (unit area), with the sigma of the
        stage.
    stages : (iterations + 1,) array of int
        Stage of each row.
    residual : float
        ``||f_tau - g|| / ||g - mean(g)||`` in L2 on the surface, weighted by the mask, or the
        largest error of a landmark, in tenths of sqrt(area), if that is larger. Goal and verdict
        use it.
    verified_residual : float
        The residual of the source along flow lines of the continuous fields (see
        `abfm.matching.verify`), estimated from some of the vertices on large meshes; NaN if
        unknown.
    folded : float
        Share of the faces, 0 to 1, that this flow folds (`Verification.folded`); NaN if unknown.
    stop_reason : StopReason
        Why it stopped.
    verdict : Verdict
        Outcome, cause and advice.
    path : tuple of PathStep
        The steps of the continuation, from large to small sigma; by default this field alone.
    step : int
        The number of the step that is the match.
    doubt : str
        A warning that values of a file do not match its field, in a line; empty if they do.
    bound : Bound, optional
        How well the map satisfies the bound of `abfm.matching.limit_distortion`; None without a
        bound.
    """

    problem: Problem
    fine_velocity: FloatArray = field(repr=False)
    advected: FloatArray = field(repr=False)
    energy_history: FloatArray = field(repr=False)
    stages: IntArray = field(repr=False)
    residual: float
    verified_residual: float
    folded: float
    stop_reason: StopReason
    verdict: Verdict
    path: tuple[PathStep, ...] = field(default=(), repr=False)
    step: int = 0
    load_warning: str = ""
    bound: Bound | None = None

    def __post_init__(self) -> None:
        # a copy with another field is on no path, and within no bound
        if not self.path or self.path[self.step].velocity is not self.fine_velocity:
            p = self.parameters
            known = self.fine_velocity, self.residual, self.verified_residual, self.folded
            alone = PathStep(p.last_sigma, p.alpha, p.solver.reach, *known)
            self.__dict__.update(path=(alone,), step=0, bound=None)

    @property
    def mesh(self) -> TriangleMesh:
        """The mesh, as it was given."""
        return self.problem.mesh

    @property
    def source(self) -> FloatArray:
        """The source, (V, C)."""
        return self.problem.source

    @property
    def target(self) -> FloatArray:
        """The target, (V, C)."""
        return self.problem.target

    @property
    def parameters(self) -> Parameters:
        """The parameters of the problem."""
        return self.problem.parameters

    @property
    def mask(self) -> FloatArray | None:
        """Weight of the mismatch at each vertex, (V,), or None."""
        return self.problem.mask

    @property
    def weights(self) -> FloatArray:
        """Weight of each channel's mismatch, (C,)."""
        return self.problem.weights

    @property
    def channels_given(self) -> bool:
        """Tell whether source and target came as (V, C); else as (V,), and `advect` answers so."""
        return self.problem.channels_given

    @cached_property
    def flow(self) -> Flow:
        """The flow of the fields."""
        return Flow(
            self.mesh, self.fine_velocity, self.parameters.tau, self.parameters.paper.method
        )

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields on the mesh itself, (N, F, 3): means over children if it was refined."""
        return mean_of_children(self.fine_velocity, len(self.mesh.faces))

    @property
    def refined(self) -> int:
        """The number of subdivisions of the mesh on which the fields are."""
        return times_subdivided(self.fine_velocity.shape[1], self.mesh)

    @cached_property
    def fine(self) -> Match:
        """The same match on the mesh on which its fields are, with the functions there."""
        if not self.refined:
            return self
        problem = self.problem.refined(self.refined)
        advected = _carried(problem, self.fine_velocity)
        return replace(self, problem=problem, advected=advected, path=(), step=0)

    @cached_property
    def landmark_errors(self) -> FloatArray | None:
        """The distance along the surface of each landmark's end, by flow lines, from its target,
        (L,), as fractions of sqrt(area); None without landmarks.
        """
        marks = self.problem.landmarks
        if marks is None:
            return None
        return marks.errors_along(self.mesh, self.fine_velocity, self.parameters.tau)

    @property
    def worse_residual(self) -> float:
        """The larger residual of both checks, the discrete flow and flow lines."""
        return worse_residual(self.residual, self.verified_residual)

    @cached_property
    def mismatch(self) -> float:
        """``||f_tau - g|| / ||g||`` of the functions, as the paper defines it, on the mesh on which
        the fields are; on the mesh itself if that is unknown.
        """
        known = self.path[self.step].mismatch
        own = self.problem.functions
        return own.mismatch(self.advected.T) if math.isnan(known) else known

    @cached_property
    def initial_residual(self) -> float:
        """The residual without motion."""
        marks = self.problem.landmarks
        errors = None if marks is None else marks.initial_errors
        return self.problem.left(self.problem.functions.source, errors)

    def advect(self, t: ArrayLike) -> FloatArray:
        """The source, advected to time ``t``, in its original shape; times as in `push`."""
        if self.refined:
            carried = self.fine.advect(t)
            axis = np.ndim(t)
            return np.take(carried, np.arange(len(self.mesh.vertices)), axis)
        return self.push(self.source if self.channels_given else self.source[:, 0], t)

    def push(self, h: ArrayLike, t: ArrayLike) -> FloatArray:
        """Any function (V,) or (V, C), advected by the same flow to time ``t``, also beyond tau.

        A negative time reverses the flow; the reverse of linearised steps has the same steps with
        the sign changed, in reverse order, which is not an exact inverse. An array of times (T,)
        gives (T, ...), much faster than one by one.

        Raises
        ------
        AbfmError
            If ``h`` does not fit the mesh, or the flow overflows or is too long.
        """
        return self.flow.push(h, t)

    def at_step(self, step: int) -> Match:
        """Return the match of another step of its path, with a verdict of its own; IndexError if
        there is no such step.
        """
        if step == self.step:
            return self
        found = self.path[step]
        problem = self.problem.refined(found.refined(self.mesh))
        carried = _carried(problem, found.velocity)
        other = replace(
            self,
            fine_velocity=found.velocity,
            advected=carried[: len(self.mesh.vertices)],
            residual=found.residual,
            verified_residual=found.verified_residual,
            folded=found.folded,
            step=step % len(self.path),
            bound=None,
        )
        judged = other.judged()
        judged = replace(judged, verdict=judged.verdict.for_step(found.sigma))
        return judged._checked_against(problem, carried)

    def with_step(self, step: PathStep) -> Match:
        """Return the match of a step after its path, whose numbers are recomputed by both checks;
        AbfmError if its fields cannot advect the source.
        """
        problem = self.problem.refined(step.refined(self.mesh))
        carried = _carried(problem, step.velocity)
        path, number = (*self.path, step), len(self.path)
        other = replace(
            self, fine_velocity=step.velocity, path=path, step=number, bound=None, load_warning=""
        )
        return other._recomputed(problem, carried)

    def within(self, bound: Bound) -> Match:
        """Return the match as the result of a search within a bound of distortion."""
        return replace(self, bound=bound, verdict=self.verdict.within(bound))

    def reverified(self) -> Match:
        """Return the match if its numbers agree with its field, which advects the source once; else
        with recomputed numbers, and a `load_warning`.
        """
        problem = self.problem.refined(self.refined)
        try:
            carried = _carried(problem, self.fine_velocity)
        except AbfmError as error:
            load_warning = f"its field cannot advect the source: {error}"
            verdict = Verdict(Outcome.NOT_REACHED, load_warning, "", cause=Cause.INCONSISTENT)
            return replace(self, verdict=verdict, load_warning=load_warning)
        return self._checked_against(problem, carried)

    @np.errstate(over="ignore", invalid="ignore")  # of functions that are refused today
    def _checked_against(self, problem: Problem, carried: FloatArray) -> Match:
        """Return it, recomputed if its numbers disagree with the advected source (V, C)."""
        advected = carried[: len(self.mesh.vertices)]
        left = problem.left(carried.T, self.landmark_errors)
        off = self.problem.functions.relative_size((advected - self.advected).T)
        agreed = max(_RESIDUAL_DIFFERENCE, _RESIDUAL_SHARE * self.residual)
        if left > self.residual + agreed:
            load_warning = (
                f"its residual is {self.residual:.3g}, but that of its field is {left:.3g}"
            )
        elif off > agreed:
            load_warning = f"its advected source differs by {off:.3g} from that of its field"
        elif self._has_better_verdict():
            load_warning = (
                f"its verdict is {self.verdict.kind}, its residual {self.worse_residual:.3g}"
            )
        else:
            return self
        # the numbers of an interrupted run are those of a coarser level
        is_estimate = self.stop_reason is StopReason.CANCELLED and math.isnan(
            self.verified_residual
        )
        other = self._recomputed(problem, carried, is_verified=not is_estimate)
        return replace(other, load_warning="" if is_estimate else load_warning)

    def _recomputed(self, problem: Problem, carried: FloatArray, is_verified: bool = True) -> Match:
        """Return it with the numbers of its field, and the source (V, C) that this advects."""
        numbers, own = dict[str, float](), self.path[self.step]
        if is_verified:
            with suppress(AbfmError):  # too fast for flow lines
                energy = MatchingEnergy(problem)
                numbers = flow_line_measures(energy, self.fine_velocity / energy.length_scale)
        numbers |= {"held_out": own.held_out, "score": own.score}
        numbers["mismatch"] = problem.functions.mismatch(carried.T)
        residual = problem.left(carried.T, self.landmark_errors)
        own = PathStep(own.sigma, own.alpha, own.reach, own.velocity, residual, **numbers)
        other = replace(
            self,
            advected=carried[: len(self.mesh.vertices)],
            residual=residual,
            verified_residual=own.verified_residual,
            folded=own.folded,
            path=(*self.path[: self.step], own, *self.path[self.step + 1 :]),
        )
        return other.judged()

    def _has_better_verdict(self) -> bool:
        """Return whether the verdict is better than the residual allows."""
        due = outcome_of(self.worse_residual, self.parameters.goal)
        return self.verdict.kind in (Outcome.MATCHED, Outcome.NEARLY) and (
            due.rank > self.verdict.kind.rank
        )

    @property
    def _evidence(self) -> Evidence:
        marks, errors = self.problem.landmarks, self.landmark_errors
        return Evidence(
            np.ascontiguousarray(self.advected.T),
            self.residual,
            self.stop_reason,
            self.verified_residual,
            self.folded,
            log2_area=self.path[self.step].log2_area,
            refined=self.refined,
            landmarks=None if marks is None or errors is None else (marks.initial_errors, errors),
            held_out=self.path[self.step].held_out,
            bound=self.bound,
        )

    def judged(self, energies: FloatArray | None = None) -> Match:
        """Return the match with the verdict of its numbers and, if known, the energies of the last
        stage's iterates.
        """
        evidence = replace(self._evidence, energies=energies)
        found = replace(self, verdict=judge(self.problem.functions, evidence, self.parameters))
        vars(found)["landmark_errors"] = self.landmark_errors  # which take time
        return found

    @cached_property
    def facts(self) -> Facts:
        """Outcome, headline, reason, advice, numbers and warnings, as every view shows them."""
        return self.report.facts()

    @property
    def report(self) -> Report:
        """The report that writes the facts."""
        return Report(
            self.verdict,
            self._evidence,
            self.parameters,
            self.initial_residual,
            self.mismatch,
            self.problem.is_of_landmarks,
            self.path[self.step].log2_area_95,
            self.load_warning,
            choice_text(self.path, self.step) if self.bound is None else "",
        )

    def start_for(self, parameters: Parameters) -> FloatArray:
        """The fields (N, 4^k F, 3) as a start with other parameters, scaled to their tau."""
        faster: FloatArray = self.fine_velocity * (self.parameters.tau / parameters.tau)
        return faster

    def point_map(self, t: float | None = None, inverse: bool = False) -> PointMap:
        """Return the origin of each vertex's value at time ``t``, or the end of each vertex if
        ``inverse``, by flow lines, see `abfm.Flow.point_map`.
        """
        return self.flow.point_map(t, inverse)

    def functional_map(self, k: int, t: float | None = None) -> FloatArray:
        """Return the flow in the first k eigenfunctions, see `abfm.Flow.functional_map`."""
        return self.flow.functional_map(k, t)

    def distortion(self, t: float | None = None) -> Distortion:
        """Measure the distortion of each face, see `abfm.Flow.distortion`."""
        return self.flow.distortion(t)

    def verify(self, subdivided: bool = True) -> Verification:
        """Verify that the fields carry the source to the target, see `abfm.matching.verify`."""
        return verify(self.problem, self.fine_velocity, subdivided)

    def save(self, path: File) -> None:
        """Write a result file (``.npz``, no pickles) atomically, or raise ResultError.

        It contains the functions and landmarks, and no other data terms.
        """
        results.save_arrays(path, results.made(self._parts()))

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write the valid parts of a match that `save` refuses, at least its field; return the
        missing ones and why, a line each, or raise ResultError.
        """
        return results.save_parts(path, self._parts(), substitutes(self))

    def _parts(self) -> results.Parts:
        return {"the mesh": partial(results.mesh_arrays, self.mesh), **match_parts(self)}


def _carried(problem: Problem, velocity: FloatArray) -> FloatArray:
    """Return the source of a problem, advected to tau by fields (N, F, 3), (V, C)."""
    p = problem.parameters
    return Flow(problem.mesh, velocity, p.tau, p.paper.method).push(problem.source)


def match_parts(match: Match) -> dict[str, Callable[[], Mapping[str, Any]]]:
    """Return the parts of a match's file except its mesh; any except the fields may fail, and
    unknown values are left out.
    """
    problem, remedies, marks = match.problem, match.verdict.remedies, match.problem.landmarks
    grouped = {
        "the fields": ("velocity", "fine_velocity") if match.refined else ("velocity",),
        "the energies": ("energy_history", "stages"),
        "the path": ("path_steps", "path_step", "path_fields", "path_velocity"),
        "the functions' texts": tuple(results.SPEC_ENTRIES),
        "the landmarks": (*results.LANDMARK_ENTRIES, "landmark_errors"),
    }
    left_out = {name for names in grouped.values() for name in names} | {"fine_velocity"}
    parts: dict[str, Callable[[], Mapping[str, Any]]] = {
        name: partial(_known, match, (name,))
        for name in results.MATCH_ENTRIES
        if name not in left_out
    }
    parts |= {
        "parameters": lambda: {"parameters": json.dumps(match.parameters.to_dict())},
        "verdict": lambda: {"verdict": match.verdict.texts},
        "remedies": lambda: (
            {"remedies": json.dumps([asdict(each) for each in remedies])} if remedies else {}
        ),
        "approximate": lambda: {"approximate": True} if problem.functions.approximate else {},
        "bound": lambda: {} if match.bound is None else {"bound": np.array(match.bound, float)},
        "the fields": partial(_known, match, grouped["the fields"]),
        "the energies": partial(_known, match, grouped["the energies"]),
        "the path": lambda: path_arrays(match.path, match.step, match.mesh),
        "the functions' texts": problem.spec_arrays,
        "the landmarks": lambda: (
            {} if marks is None else {**marks.arrays(), **_known(match, ("landmark_errors",))}
        ),
    }
    return parts


def substitutes(match: Match) -> dict[str, Any]:
    """Return arrays in place of those of a match that cannot be saved: recomputed from its field,
    or unknown. Loading the file recomputes what disagrees with the field.
    """
    advected, residual = match.source, 0.0
    with suppress(Exception):  # any error of a field that was never checked
        problem = match.problem.refined(match.refined)
        carried = _carried(problem, match.fine_velocity)
        advected = carried[: len(match.mesh.vertices)]
        residual = problem.left(carried.T, match.landmark_errors)
    return {
        "advected": advected,
        "energy_history": np.zeros((1, 3)),
        "stages": np.zeros(1, np.int64),
        "residual": residual,
        "stop_reason": str(StopReason.GIVEN),
        "verdict": Verdict(Outcome.NOT_REACHED, "", "", cause=Cause.INCONSISTENT).texts,
    }


def _known(match: Match, names: tuple[str, ...]) -> dict[str, Any]:
    """Return attributes of a match; unknown values are left out."""
    values = {name: getattr(match, name) for name in names}
    return {
        name: value
        for name, value in values.items()
        if not (value is None or (isinstance(value, float) and math.isnan(value)))
    }


def load_match(path: File) -> Match:
    """Read a file of `Match.save`; ResultError if it is missing, damaged, or not a result.

    Values that disagree with the field are recomputed, with a warning in ``match.load_warning``.
    """

    def made(arrays: results.Arrays) -> Match:
        return match_of(results.mesh_of(arrays), arrays)

    return results.loaded(path, results.RESULT, made).reverified()


def match_of(mesh: TriangleMesh, arrays: results.Arrays) -> Match:
    """Return the match of a file's arrays; any error if they do not fit."""
    problem, velocity = problem_of(mesh, arrays), arrays["velocity"]
    segments, fine = problem.parameters.solver.segments, arrays.get("fine_velocity", velocity)
    if segments not in (0, len(velocity)):
        raise ValueError(f"{len(velocity)} fields, but parameters say {segments}")
    times_subdivided(fine.shape[1], mesh)
    fastest = np.abs(fine).max()
    if fastest > results.SIZE_MAX * mesh.length_scale:
        raise ValueError(
            f"velocity has the value {fastest:.3g}; expected up to {results.SIZE_MAX:g} length "
            "scales of the mesh"
        )
    has_path = any(name.startswith("path_") for name in arrays)
    path, step = path_of(arrays, fine, mesh) if has_path else ((), 0)
    remedies = _remedies(str(arrays.get("remedies", "[]")))
    return Match(
        problem=problem,
        fine_velocity=fine,
        advected=arrays["advected"],
        energy_history=arrays["energy_history"],
        stages=arrays["stages"],
        residual=float(arrays["residual"]),
        verified_residual=float(arrays.get("verified_residual", math.nan)),
        folded=float(arrays.get("folded", math.nan)),
        stop_reason=StopReason(str(arrays["stop_reason"])),
        verdict=Verdict.of_texts(arrays["verdict"].tolist(), remedies),
        path=path,
        step=step,
        bound=Bound.of(arrays["bound"]) if "bound" in arrays else None,
    )


def _remedies(text: str) -> tuple[Remedy, ...]:
    """Return the remedies of `match_parts`."""
    try:
        found = tuple(Remedy(**remedy) for remedy in from_json(text))
    except AbfmError:
        raise
    except (TypeError, ValueError) as error:
        names = ", ".join(field.name for field in fields(Remedy))
        raise ValueError(
            f"the remedies are {one_line(text, 60)!r}; expected a list in JSON of what has {names}"
        ) from error
    kinds = {"label": str, "words": str, "parameters": dict, "goes_on": bool}
    for remedy in found:
        for name, kind in kinds.items():
            if not isinstance(getattr(remedy, name), kind):
                raise ValueError(f"the {name} of a remedy is no {kind.__name__}")
    return found

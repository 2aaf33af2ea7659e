"""The result of a match: the class `Match` and its file."""

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
from abfm.matching.judging.determined import determined
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
from abfm.wording import counted

_RESIDUAL_DIFFERENCE = 0.005
"""Allowed difference between the stored residual and the residual computed from the field.

It is a tenth of the usual goal. Rounding errors are 1e-6 of it."""
_RESIDUAL_SHARE = 0.05  # allowed difference relative to the stored residual


@dataclass(frozen=True, eq=False)
class Match(Display):
    """The result of a match: fields whose flow advects the source towards the target.

    Attributes
    ----------
    problem : Problem
        The solved problem.
    fine_velocity : (N, 4^k F, 3) array
        Tangent fields, in the input's length unit per unit of time, on the mesh or on its midpoint
        subdivision made k times.
    advected : (V, C) array
        The source, advected to tau.
    energy_history : (iterations + 1, 3) array
        Total energy, regularity and mismatch with the sigma of the stage, on the mesh scaled to
        unit area.
    stages : (iterations + 1,) array of int
        The stage of each row of the energy history.
    residual : float
        ``||f_tau - g|| / ||g - mean(g)||`` in L2 on the surface, weighted by the mask. If the
        largest error of a landmark, in tenths of sqrt(area), is larger, this error is the residual.
        Goal and verdict use this residual.
    verified_residual : float
        The residual of the source along flow lines of the continuous fields. On large meshes the
        residual is estimated from some of the vertices. NaN if unknown. See `abfm.matching.verify`.
    folded : float
        Share of the faces that the flow folds, 0 to 1 (`Verification.folded`); NaN if unknown.
    stop_reason : StopReason
        The reason why the solver stopped.
    verdict : Verdict
        Outcome, cause and advice.
    path : tuple of PathStep
        The steps of the continuation, from large to small sigma. By default the path has only this
        field.
    step : int
        Index of the step in ``path`` that is the match.
    load_warning : str
        A warning, in one line, if values of the file did not match its field; otherwise empty.
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
        # a copy with another field has neither the path nor the bound
        if not self.path or self.path[self.step].velocity is not self.fine_velocity:
            p = self.parameters
            known = self.fine_velocity, self.residual, self.verified_residual, self.folded
            alone = PathStep(p.last_sigma, p.alpha, p.solver.reach, *known)
            self.__dict__.update(path=(alone,), step=0, bound=None)

    @property
    def mesh(self) -> TriangleMesh:
        """The mesh of the problem."""
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
        """Weight of the mismatch at each vertex, (V,); None if it is 1 everywhere."""
        return self.problem.mask

    @property
    def weights(self) -> FloatArray:
        """Weight of the mismatch of each channel, (C,)."""
        return self.problem.weights

    @property
    def channels_given(self) -> bool:
        """Whether source and target were given as (V, C); `advect` then returns this shape."""
        return self.problem.channels_given

    @cached_property
    def flow(self) -> Flow:
        """The flow of the fields."""
        p = self.parameters
        return Flow(self.mesh, self.fine_velocity, p.tau, p.paper.method)

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields on the mesh itself, (N, F, 3); on a refined mesh, means over child faces."""
        return mean_of_children(self.fine_velocity, len(self.mesh.faces))

    @property
    def refined(self) -> int:
        """The number of times the mesh is subdivided to get the mesh of the fields."""
        return times_subdivided(self.fine_velocity.shape[1], self.mesh)

    @cached_property
    def fine(self) -> Match:
        """The match on the subdivided mesh of its fields, with its functions evaluated there."""
        if not self.refined:
            return self
        problem = self.problem.refined(self.refined)
        advected = _advected(problem, self.fine_velocity)
        return replace(self, problem=problem, advected=advected, path=(), step=0)

    @cached_property
    def landmark_errors(self) -> FloatArray | None:
        """The errors of the landmarks along flow lines, (L,); None without landmarks.

        The errors are distances along the surface from the ends of the landmarks to their targets,
        as fractions of sqrt(area).
        """
        landmarks = self.problem.landmarks
        if landmarks is None:
            return None
        return landmarks.errors_along(self.mesh, self.fine_velocity, self.parameters.tau)

    @cached_property
    def determined(self) -> FloatArray:
        """The share of the velocity on each face that the data determine, (N, F), from 0 to 1.

        Smoothness determines the rest. See ``abfm.matching.judging.determined``.
        """
        return determined(
            self.problem, self.velocity, self.fine_velocity, self.worse_residual, self.advect
        )

    @property
    def worse_residual(self) -> float:
        """The larger one of two residuals: of the discrete flow and along flow lines."""
        return worse_residual(self.residual, self.verified_residual)

    @cached_property
    def mismatch(self) -> float:
        """The mismatch of the functions as in the paper, ``||f_tau - g|| / ||g||``.

        The mismatch refers to the mesh of the fields or, if unknown there, to the mesh itself.
        """
        known, functions = self.path[self.step].mismatch, self.problem.functions
        return functions.mismatch(self.advected.T) if math.isnan(known) else known

    @cached_property
    def initial_residual(self) -> float:
        """The residual without motion."""
        landmarks = self.problem.landmarks
        errors = None if landmarks is None else landmarks.initial_errors
        return self.problem.residual(self.problem.functions.source, errors)

    def advect(self, t: ArrayLike) -> FloatArray:
        """Return the source advected to time ``t``, in its original shape; see `push`."""
        if self.refined:
            fine_advected = self.fine.advect(t)
            return np.take(fine_advected, np.arange(len(self.mesh.vertices)), np.ndim(t))
        return self.push(self.source if self.channels_given else self.source[:, 0], t)

    def push(self, h: ArrayLike, t: ArrayLike) -> FloatArray:
        """Return a function (V,) or (V, C) advected along the flow to time ``t``.

        Times may exceed tau, and negative times reverse the flow. The reverse of linearised steps
        has the same steps with opposite sign, in reverse order, which is not an exact inverse. An
        array of times (T,) returns (T, ...) and is much faster than separate calls.

        Raises
        ------
        AbfmError
            If ``h`` does not fit the mesh, or if the flow overflows or is too long.
        """
        return self.flow.push(h, t)

    def at_step(self, step: int) -> Match:
        """Return the match of another step of the path, with the verdict of that step.

        Raise IndexError if there is no such step.
        """
        if step == self.step:
            return self
        found = self.path[step]
        problem = self.problem.refined(found.refined(self.mesh))
        fine_advected = _advected(problem, found.velocity)
        other = replace(
            self,
            fine_velocity=found.velocity,
            advected=fine_advected[: len(self.mesh.vertices)],
            residual=found.residual,
            verified_residual=found.verified_residual,
            folded=found.folded,
            step=step % len(self.path),
            bound=None,
        )
        judged = other.judged()
        judged = replace(judged, verdict=judged.verdict.for_step(found.sigma))
        return judged._checked_against(problem, fine_advected)

    def with_step(self, step: PathStep) -> Match:
        """Return the match of a new step, which is appended to the path.

        Both checks measure the step again. Raise AbfmError if its fields cannot advect the source.
        """
        problem = self.problem.refined(step.refined(self.mesh))
        fine_advected = _advected(problem, step.velocity)
        path, number = (*self.path, step), len(self.path)
        other = replace(
            self, fine_velocity=step.velocity, path=path, step=number, bound=None, load_warning=""
        )
        return other._recomputed(problem, fine_advected)

    def with_bound(self, bound: Bound) -> Match:
        """Return a copy with the attribute ``bound``; the verdict may name the bound as cause.

        See `Verdict.with_bound`.
        """
        return replace(self, bound=bound, verdict=self.verdict.with_bound(bound))

    def reverified(self) -> Match:
        """Return the match after verifying its numbers, which takes one advection of the source.

        Numbers that disagree with the field are recomputed, and ``load_warning`` states why.
        """
        problem = self.problem.refined(self.refined)
        try:
            fine_advected = _advected(problem, self.fine_velocity)
        except AbfmError as error:
            load_warning = f"the stored field cannot advect the source: {error}"
            verdict = Verdict(Outcome.NOT_REACHED, load_warning, "", cause=Cause.INCONSISTENT)
            return replace(self, verdict=verdict, load_warning=load_warning)
        return self._checked_against(problem, fine_advected)

    @np.errstate(over="ignore", invalid="ignore")  # files may have functions that are too large
    def _checked_against(self, problem: Problem, fine_advected: FloatArray) -> Match:
        """Return the match if a newly advected source (V, C) agrees with it; else recompute it."""
        advected = fine_advected[: len(self.mesh.vertices)]
        residual = problem.residual(fine_advected.T, self.landmark_errors)
        off = self.problem.functions.relative_size((advected - self.advected).T)
        agreed = max(_RESIDUAL_DIFFERENCE, _RESIDUAL_SHARE * self.residual)
        if residual > self.residual + agreed:
            load_warning = (
                f"the stored residual is {self.residual:.3g}, but that of the field is "
                f"{residual:.3g}"
            )
        elif off > agreed:
            load_warning = f"the stored advected source differs by {off:.3g} from that of the field"
        elif self._has_better_verdict():
            load_warning = (
                f"the stored verdict is {self.verdict.kind}, but the residual is "
                f"{self.worse_residual:.3g}"
            )
        else:
            return self
        # an interrupted run may have measured its residual on a coarser mesh
        is_unknown = math.isnan(self.verified_residual)
        is_estimate = self.stop_reason is StopReason.CANCELLED and is_unknown
        other = self._recomputed(problem, fine_advected, is_verified=not is_estimate)
        return replace(other, load_warning="" if is_estimate else load_warning)

    def _recomputed(
        self, problem: Problem, fine_advected: FloatArray, is_verified: bool = True
    ) -> Match:
        """Return the match with numbers recomputed from its field and advected source (V, C)."""
        numbers, selected = dict[str, float](), self.path[self.step]
        if is_verified:
            with suppress(AbfmError):  # flow lines that cross too many faces
                energy = MatchingEnergy(problem)
                numbers = flow_line_measures(energy, self.fine_velocity / energy.length_scale)
        numbers |= {"held_out": selected.held_out, "score": selected.score}
        numbers["mismatch"] = problem.functions.mismatch(fine_advected.T)
        residual = problem.residual(fine_advected.T, self.landmark_errors)
        selected = PathStep(
            selected.sigma, selected.alpha, selected.reach, selected.velocity, residual, **numbers
        )
        other = replace(
            self,
            advected=fine_advected[: len(self.mesh.vertices)],
            residual=residual,
            verified_residual=selected.verified_residual,
            folded=selected.folded,
            path=(*self.path[: self.step], selected, *self.path[self.step + 1 :]),
        )
        return other.judged()

    def _has_better_verdict(self) -> bool:
        due, kind = outcome_of(self.worse_residual, self.parameters.goal), self.verdict.kind
        return kind in (Outcome.MATCHED, Outcome.NEARLY) and due.rank > kind.rank

    @property
    def _evidence(self) -> Evidence:
        landmarks, errors = self.problem.landmarks, self.landmark_errors
        pair = None if landmarks is None or errors is None else (landmarks.initial_errors, errors)
        return Evidence(
            np.ascontiguousarray(self.advected.T),
            self.residual,
            self.stop_reason,
            self.verified_residual,
            self.folded,
            log2_area=self.path[self.step].log2_area,
            refined=self.refined,
            landmarks=pair,
            held_out=self.path[self.step].held_out,
            bound=self.bound,
        )

    def judged(self, energies: FloatArray | None = None) -> Match:
        """Return the match with a new verdict, which is determined by its numbers.

        ``energies`` are those of the iterates of the last stage, if known.
        """
        evidence = replace(self._evidence, energies=energies)
        found = replace(self, verdict=judge(self.problem.functions, evidence, self.parameters))
        vars(found)["landmark_errors"] = self.landmark_errors  # it is slow to compute again
        return found

    @cached_property
    def facts(self) -> Facts:
        """Outcome, headline, reason, advice, numbers and warnings of the match."""
        return self.report.facts()

    @property
    def report(self) -> Report:
        """The verdict and the measurements from which `facts` are made."""
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
        """Return the fields (N, 4^k F, 3) as a start for other parameters.

        If tau differs, the fields are scaled so that their map does not change.
        """
        faster: FloatArray = self.fine_velocity * (self.parameters.tau / parameters.tau)
        return faster

    def point_map(self, t: float | None = None, inverse: bool = False) -> PointMap:
        """Return the points whose flow lines reach the vertices at time ``t``, by default tau.

        If ``inverse``, return the points that flow lines from the vertices reach at time ``t``. See
        `abfm.Flow.point_map`.
        """
        return self.flow.point_map(t, inverse)

    def functional_map(self, k: int, t: float | None = None) -> FloatArray:
        """Return the matrix (k, k) of the flow in the basis of k eigenfunctions.

        See `abfm.Flow.functional_map`.
        """
        return self.flow.functional_map(k, t)

    def distortion(self, t: float | None = None) -> Distortion:
        """Return the distortion of each face, see `abfm.Flow.distortion`."""
        return self.flow.distortion(t)

    def verify(self, subdivided: bool = True) -> Verification:
        """Verify by independent checks that the fields advect the source to the target.

        See `abfm.matching.verify`.
        """
        return verify(self.problem, self.fine_velocity, subdivided)

    def save(self, path: File) -> None:
        """Write a result file (``.npz``, no pickles) atomically, or raise ResultError.

        The file contains the functions and landmarks, and no other data terms.
        """
        results.save_arrays(path, results.all_arrays(self._parts()))

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write the valid parts of a match that `save` cannot write, at least its field.

        Return one line for each missing part, with the reason. Raise ResultError if the field
        cannot be written.
        """
        return results.save_parts(path, self._parts(), substitutes(self))

    def _parts(self) -> results.Parts:
        return {"the mesh": partial(results.mesh_arrays, self.mesh), **match_parts(self)}


def _advected(problem: Problem, velocity: FloatArray) -> FloatArray:
    p = problem.parameters
    return Flow(problem.mesh, velocity, p.tau, p.paper.method).push(problem.source)


def match_parts(match: Match) -> dict[str, Callable[[], Mapping[str, Any]]]:
    """Return functions that make the parts of the file of a match, except its mesh, by name.

    A function may raise an error; only the part with the fields is indispensable. Unknown values
    are omitted.
    """
    problem, remedies, landmarks = match.problem, match.verdict.remedies, match.problem.landmarks
    grouped = {
        "the fields": ("velocity", "fine_velocity") if match.refined else ("velocity",),
        "the energies": ("energy_history", "stages"),
        "the path": ("path_steps", "path_step", "path_fields", "path_velocity"),
        "the function specs": tuple(results.SPEC_ENTRIES),
        "the landmarks": (*results.LANDMARK_ENTRIES, "landmark_errors"),
    }
    excluded = {name for names in grouped.values() for name in names} | {"fine_velocity"}
    parts: dict[str, Callable[[], Mapping[str, Any]]] = {
        name: partial(_known, match, (name,))
        for name in results.MATCH_ENTRIES
        if name not in excluded
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
        "the function specs": problem.spec_arrays,
        "the landmarks": lambda: (
            {}
            if landmarks is None
            else {**landmarks.arrays(), **_known(match, ("landmark_errors",))}
        ),
    }
    return parts


def substitutes(match: Match) -> dict[str, Any]:
    """Return arrays, by name, that replace those of a match that cannot be saved.

    Advected source and residual are recomputed from the field if possible.
    """
    advected, residual = match.source, 0.0
    with suppress(Exception):  # any error of a field that was never checked
        problem = match.problem.refined(match.refined)
        fine_advected = _advected(problem, match.fine_velocity)
        advected = fine_advected[: len(match.mesh.vertices)]
        residual = problem.residual(fine_advected.T, match.landmark_errors)
    return {
        "advected": advected,
        "energy_history": np.zeros((1, 3)),
        "stages": np.zeros(1, np.int64),
        "residual": residual,
        "stop_reason": str(StopReason.GIVEN),
        "verdict": Verdict(Outcome.NOT_REACHED, "", "", cause=Cause.INCONSISTENT).texts,
    }


def _known(match: Match, names: tuple[str, ...]) -> dict[str, Any]:
    """Return attributes by name, except those whose value is unknown (None or NaN)."""
    values = {name: getattr(match, name) for name in names}
    return {
        name: value
        for name, value in values.items()
        if not (value is None or (isinstance(value, float) and math.isnan(value)))
    }


def load_match(path: File) -> Match:
    """Read a file of `abfm.Match.save`; ResultError if it is missing, damaged or not a match.

    Values that disagree with the field are recomputed, with a warning in ``match.load_warning``.
    """
    found = results.loaded(path, results.RESULT, lambda it: match_of(results.mesh_of(it), it))
    return found.reverified()


def match_of(mesh: TriangleMesh, arrays: results.Arrays) -> Match:
    """Return the match of the arrays of a file.

    Inconsistent arrays raise an error of any type.
    """
    problem, velocity = problem_of(mesh, arrays), arrays["velocity"]
    segments, fine = problem.parameters.solver.segments, arrays.get("fine_velocity", velocity)
    if segments not in (0, len(velocity)):
        raise ValueError(
            f"it has {counted(len(velocity), 'field')}, but its parameters require {segments}"
        )
    times_subdivided(fine.shape[1], mesh)
    fastest = np.abs(fine).max()
    if fastest > results.SIZE_MAX * mesh.length_scale:
        raise ValueError(
            f"velocity has the value {fastest:.3g}; expected at most {results.SIZE_MAX:g} length "
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
    try:
        found = tuple(Remedy(**remedy) for remedy in from_json(text))
    except AbfmError:
        raise
    except (TypeError, ValueError) as error:
        names = ", ".join(field.name for field in fields(Remedy))
        raise ValueError(
            f"the remedies are {one_line(text, 60)!r}; expected a list with {names}"
        ) from error
    kinds = {"label": str, "words": str, "parameters": dict, "starts_from_field": bool}
    for remedy in found:
        for name, kind in kinds.items():
            if not isinstance(getattr(remedy, name), kind):
                raise ValueError(f"the {name} of a remedy is not of type {kind.__name__}")
    return found

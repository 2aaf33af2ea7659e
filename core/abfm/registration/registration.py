"""Registrations: correspondences by an initial map and the flow of a match on surface B."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from abfm.errors import AbfmError, ResultError
from abfm.flow.flow import Flow
from abfm.io import results
from abfm.maps.distortion import BOUNDED_SHARE, Distortion
from abfm.maps.point_maps import PointMap
from abfm.maps.spherical import is_sphere
from abfm.matching.judging.cause import Cause
from abfm.matching.judging.facts import LOG2_AREA_GOOD, known_numbers
from abfm.matching.judging.verdict import Verdict, is_registered
from abfm.matching.result import Match, match_of, match_parts, substitutes
from abfm.matching.solving.record import StopReason
from abfm.outcome import Facts, Outcome, WarningTopic, outcome_of, worse_residual
from abfm.registration.correspondence import Correspondence, correspondence_of
from abfm.types import File, FloatArray
from abfm.wording import share


class Registration(Correspondence):
    """A registration of surface A to surface B.

    The initial map transfers functions of A to B, and the flow of a match advects them on B.

    Parameters
    ----------
    initial : Correspondence
        Initial map between A and B.
    match : Match
        Match on B of A's functions, transferred by the initial map, to B's functions.
    notes : tuple of str
        Notes on the computation of initial map and match, a line each.
    functions : (V_A, C) array, optional
        Functions of A, scaled as those of the match; None if they are known on B only.
    warnings : tuple of str
        Reasons why the initial map may be wrong, a line each. With such a warning the verdict is
        that the goal was not reached.
    """

    def __init__(
        self,
        initial: Correspondence,
        match: Match,
        notes: tuple[str, ...] = (),
        functions: FloatArray | None = None,
        warnings: tuple[str, ...] = (),
    ) -> None:
        if len(match.mesh.faces) != len(initial.b.faces):
            raise ResultError(
                f"the match is on a surface with {len(match.mesh.faces)} faces; expected surface B "
                f"of the initial map, which has {len(initial.b.faces)} faces"
            )
        self.initial, self.match, self.notes = initial, match, notes
        self.functions, self.warnings = functions, warnings

    def with_match(self, match: Match, notes: tuple[str, ...] = ()) -> Registration:
        """Return a copy with another match, and with additional notes."""
        notes = (*self.notes, *notes)
        return Registration(self.initial, match, notes, self.functions, self.warnings)

    @cached_property
    def points(self) -> PointMap:
        """Map from B to A: backward along the flow, then by the initial map."""
        return self.flow.point_map().followed_by(self.initial.points)

    @cached_property
    def back(self) -> PointMap:
        """Map from A to B: by the initial map, then along the flow."""
        return self.initial.back.followed_by(self.flow.point_map(inverse=True))

    @property
    def flow(self) -> Flow:
        """Flow of the match, on B."""
        return self.match.flow

    @cached_property
    def residual(self) -> float:
        """Residual of the functions by the complete map, which is the initial map and the flow.

        At each vertex of B, the function of B is compared with that of A at the corresponding
        point. The unit is that of `Match.residual`. NaN if only landmarks were matched (see
        `landmark_errors`), if A's functions are unknown, or if the map could not be measured.
        """
        return self._residual_by(self)

    @cached_property
    def initial_residual(self) -> float:
        """Residual of the functions by the initial map alone; NaN as for `residual`."""
        return self._residual_by(self.initial)

    def _residual_by(self, found: Correspondence) -> float:
        problem = self.match.problem
        if self.functions is None or problem.is_of_landmarks:
            return math.nan
        try:
            transferred = found.transfer(self.functions)
        except AbfmError:  # flow lines of the field cross too many faces
            return math.nan
        return problem.functions.residual(np.ascontiguousarray(transferred.T))

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict of the match, or a worse one if the complete map is worse than the flow.

        The verdict is "not reached" if a warning reports that the initial map may be wrong. It also
        becomes worse if `residual`, that of the complete map, is too large.
        """
        verdict, match = self.match.verdict, self.match
        if not verdict.kind.is_good:
            return verdict
        if self.warnings:
            reason = self.warnings[0]
            return verdict.with_cause(Outcome.NOT_REACHED, Cause.INITIAL_MAP, warning=reason)
        worse = worse_residual(match.worse_residual, self.residual)
        due = outcome_of(worse, match.parameters.goal)
        if verdict.kind is Outcome.REGISTERED:
            if math.isnan(self.residual) or is_registered(worse, self.initial_residual):
                return verdict
        elif due.rank <= verdict.kind.rank:
            return verdict
        return verdict.with_cause(due, Cause.COMPLETE_MAP, residual=share(worse))

    @cached_property
    def facts(self) -> Facts:
        """Facts of the registration for reports: outcome, numbers and warnings.

        The facts are those of its match, with the residual, distortion and folded faces of the
        complete map from A to B.
        """
        match = self.match
        try:
            distortion = self.distortion()
        except AbfmError as error:  # flow lines of the field cross too many faces
            warnings = (*match.facts.warnings, *self.warnings, str(error))
            topics = (*match.facts.topics, WarningTopic.MAP_NOT_MEASURED)
            return replace(match.facts, warnings=warnings, topics=topics)
        report, faces = match.report, len(distortion.flipped)
        folded, flipped = distortion.folded, self.flipped_by_vertices()
        is_known = not math.isnan(self.residual)
        areas = distortion.log2_area
        verified = worse_residual(match.verified_residual, self.residual)
        evidence = replace(
            report.evidence, verified=verified, folded=folded / faces, log2_area=areas.mean
        )
        facts = replace(
            report,
            verdict=self.verdict,
            evidence=evidence,
            initial_residual=self.initial_residual if is_known else match.initial_residual,
            log2_area_95=areas.p95,
            distortion_min=self._distortion_min(distortion),
        ).facts()
        of_map = {
            "verified_residual": match.verified_residual,
            "map_residual": self.residual,
            "folded_faces": folded,
            "flipped_by_vertices": flipped,
        }
        warnings, topics = (*facts.warnings, *self.warnings), facts.topics
        if self.warnings and Cause.INITIAL_MAP not in topics:
            topics += (Cause.INITIAL_MAP,)
        if folded:
            warnings += (f"{folded:,} of {faces:,} faces of B are folded by the map to A",)
            topics += (WarningTopic.FOLDED_FACES,)
        if flipped and is_sphere(self.b):
            warnings += (
                f"{flipped:,} of {len(self.a.faces):,} faces of A are flipped if only its vertices "
                "are moved to B, as in a sphere.reg file",
            )
            topics += (WarningTopic.FLIPPED_FACES,)
        numbers = {**facts.numbers, **known_numbers(of_map)}
        return replace(facts, numbers=numbers, warnings=warnings, topics=topics)

    def _distortion_min(self, complete: Distortion) -> float:
        """Return the bound of distortion of the initial map; inf if the flow is hardly the cause.

        A smaller bound may be out of reach, because the flow cannot undo the initial map.
        """
        if complete.log2_area.p95 <= LOG2_AREA_GOOD:
            return 0.0
        first = self.initial.distortion()
        least = math.inf if first.folded else first.bound_of(BOUNDED_SHARE)
        return least if least < complete.bound_of(BOUNDED_SHARE) else math.inf

    @property
    def verified_residual(self) -> float:
        """Residual along flow lines on B, see `Match.verified_residual`; NaN if unknown."""
        return self.match.verified_residual

    @property
    def stop_reason(self) -> StopReason:
        """The reason why the solver stopped."""
        return self.match.stop_reason

    @property
    def landmark_errors(self) -> FloatArray | None:
        """Errors of the moved landmarks on B, (L,), in sqrt(area); None without landmarks."""
        return self.match.landmark_errors

    @property
    def energy_history(self) -> FloatArray:
        """Energies of the match, see `Match.energy_history`."""
        return self.match.energy_history

    def at_step(self, step: int) -> Registration:
        """Return the registration with the match at another step of the continuation in sigma."""
        return self.with_match(self.match.at_step(step))

    def arrays(self) -> dict[str, Any]:
        """Return the arrays that `save` writes: initial map, notes, A's functions, and match."""
        return results.all_arrays(self._parts())

    def _parts(self) -> results.Parts:
        notes, warnings, functions = self.notes, self.warnings, self.functions
        return {
            "the surfaces": self.initial.arrays,
            "the notes": lambda: {"notes": np.array(notes)} if notes else {},
            "the warnings": lambda: {"warnings": np.array(warnings)} if warnings else {},
            "A's functions": lambda: {} if functions is None else {"a_functions": functions},
            "the verdict of the map": lambda: {"registration_verdict": self.verdict.texts},
            **match_parts(self.match),
        }

    def __reduce__(self) -> tuple[Any, ...]:
        state = self.initial, self.match, self.notes, self.functions, self.warnings
        return Registration, state

    def save(self, path: File) -> None:
        """Write a file (``.npz``, no pickles), which can also be loaded as the match on B.

        An interrupted call leaves no partial file. Raises ResultError if the file cannot be
        written.
        """
        results.save_arrays(path, self.arrays(), results.REGISTRATION)

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write the file without parts that cannot be computed, see `Match.save_parts`."""
        return results.save_parts(
            path, self._parts(), substitutes(self.match), results.REGISTRATION
        )


def load_registration(path: File) -> Registration:
    """Read a file written by `abfm.Registration.save`.

    Raises ResultError if the file is missing, damaged, or contains no registration. Stored values
    that disagree with the stored field are recomputed; ``match.load_warning`` then reports this.
    """

    def made(arrays: results.Arrays) -> Registration:
        initial = correspondence_of(arrays)
        notes, warnings = (
            tuple(arrays[name].tolist()) if name in arrays else () for name in ("notes", "warnings")
        )
        match, functions = match_of(initial.b, arrays), arrays.get("a_functions")
        return Registration(initial, match, notes, functions, warnings)

    found = results.loaded(path, results.REGISTRATION, made)
    return found.with_match(found.match.reverified())

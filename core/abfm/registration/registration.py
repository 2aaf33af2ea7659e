"""A correspondence that was found by a flow: an initial map, and a match on surface B."""

from __future__ import annotations

import os
from functools import cached_property
from typing import Any

import numpy as np

from abfm.errors import ResultError
from abfm.flow.flow import Flow
from abfm.io import results
from abfm.maps.point_maps import PointMap
from abfm.matching.judging.verdict import Verdict
from abfm.matching.match import Match, match_arrays
from abfm.registration.correspondence import Correspondence
from abfm.types import FloatArray


class Registration(Correspondence):
    """A surface A registered to a surface B: where on A each vertex of B lies.

    Functions of A go to B by the initial map, and there along the flow of a match.

    Parameters
    ----------
    initial : Correspondence
        From A to B.
    match : Match
        On B, of A's functions, carried by the initial map, and B's.
    notes : tuple of str
        What is worth knowing of how they came about, a line each.
    functions : (V_A, C) array, optional
        A's, as they are compared; None where they are known on B alone.
    """

    def __init__(
        self,
        initial: Correspondence,
        match: Match,
        notes: tuple[str, ...] = (),
        functions: FloatArray | None = None,
    ) -> None:
        if len(match.mesh.faces) != len(initial.b.faces):
            raise ResultError("the match is on another surface than the initial map leads to")
        self.initial, self.match, self.notes = initial, match, notes
        self.functions = functions

    def matched_by(self, match: Match, notes: tuple[str, ...] = ()) -> Registration:
        """Return the registration with another match, and notes added."""
        return Registration(self.initial, match, (*self.notes, *notes), self.functions)

    @cached_property
    def points(self) -> PointMap:
        """Where on A each vertex of B lies: back along the flow, then by the initial map."""
        return self.flow.point_map().followed_by(self.initial.points)

    @cached_property
    def back(self) -> PointMap:
        """Where on B each vertex of A lies: by the initial map, then along the flow."""
        return self.initial.back.followed_by(self.flow.point_map(inverse=True))

    @property
    def flow(self) -> Flow:
        """The flow on B."""
        return self.match.flow

    @property
    def verdict(self) -> Verdict:
        """What the match came to, why, and what to try."""
        return self.match.verdict

    @property
    def landmark_errors(self) -> FloatArray | None:
        """How far landmarks are left from their places on B, (L,), in sqrt(area), or None."""
        return self.match.landmark_errors

    @property
    def energy_history(self) -> FloatArray:
        """As of a `Match`."""
        return self.match.energy_history

    def at_step(self, step: int) -> Registration:
        """Return the registration at another step of the path of its match."""
        return self.matched_by(self.match.at_step(step))

    def arrays(self) -> dict[str, Any]:
        """Return what files hold: the initial map, the notes, A's functions, and the match."""
        own: dict[str, Any] = {"notes": np.array(self.notes)} if self.notes else {}
        if self.functions is not None:
            own["a_functions"] = self.functions
        return self.initial.arrays() | own | match_arrays(self.match)

    def __reduce__(self) -> tuple[Any, ...]:
        return Registration, (self.initial, self.match, self.notes, self.functions)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError; as a
        result file it holds the match on B.
        """
        results.save_arrays(path, self.arrays(), results.REGISTRATION)

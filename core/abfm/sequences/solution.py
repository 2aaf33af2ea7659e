"""What was found of a sequence, and its files: one ``.npz`` of plain arrays, no pickles."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Self

import numpy as np

from abfm.io import results
from abfm.matching.judging.cause import Cause
from abfm.matching.judging.verdict import Verdict
from abfm.mesh import TriangleMesh
from abfm.outcome import Outcome
from abfm.reading import from_json
from abfm.sequences.frames import Frames
from abfm.sequences.parameters import SequenceParameters
from abfm.sequences.verdicts import is_unsolved
from abfm.types import BoolArray, File, FloatArray

_NUMBERS = (
    "gamma",
    "sigma",
    "noise",
    "motion_share",
    "has_motion",
    "energies",
    "residual",
    "verified_residual",
    "folded",
)


@dataclass(frozen=True, eq=False)
class Solution:
    """Frames of a function, and the field of each interval between two of them.

    Attributes
    ----------
    mesh : TriangleMesh, or whatever `abfm.load_mesh` takes
    frames : (T, V, C) array
        As given, and filled in where a value is not finite in some frame, or the mask is 0.
    times : (T,) array
        Ascending.
    velocity : (T - 1, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time.
    parameters : SequenceParameters
        As given, with the ``alpha`` and ``order`` of the norm that the intervals have;
        ``automatic`` lists those of the two that were chosen, and ``sigma`` is None if it was.
    gamma : float
        How much neighbouring fields were held together.
    residual, verified_residual, folded : (T - 1,) array
        Of each interval, as in `Match`: by the discrete flow, by flow lines, and the share of faces
        that these fold; NaN where unknown.
    noise : float
        What independent noise on vertices leaves of an interval, at most, as a residual: the median
        over intervals, of which each is judged by its own.
    verdicts : tuple of Verdict
        What each interval came to.
    motion_share : float
        How much of what motion along the fields adds to the linear blend of two frames explains
        frames that were left out, from 0 to 1; NaN if it is unknown. See `motion_shares`.
    has_motion : bool
        False if frames that were left out show that the fields are no motion, as of a standing
        wave.
    sigma : float
        That of all intervals, in the frames' deviation (or absolute, as the parameters say).
    """

    _frames: Frames = field(repr=False)
    velocity: FloatArray = field(repr=False)
    parameters: SequenceParameters = field(repr=False)
    gamma: float
    sigma: float
    energies: FloatArray = field(repr=False)  # (T - 1, 2, 3)
    residual: FloatArray = field(repr=False)
    verified_residual: FloatArray = field(repr=False)
    folded: FloatArray = field(repr=False)
    noise: float
    verdicts: tuple[Verdict, ...] = field(repr=False)
    motion_share: float
    has_motion: bool

    @property
    def mesh(self) -> TriangleMesh:
        return self._frames.mesh

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the frames, a line each."""
        return self._frames.notes

    @property
    def frames(self) -> FloatArray:
        return self._frames.values

    @property
    def times(self) -> FloatArray:
        return self._frames.times

    @property
    def unit_of_time(self) -> str:
        """Unit of the times: ``s``, or empty if they are numbers of frames."""
        return self._frames.unit_of_time

    def __len__(self) -> int:
        """Return how many intervals there are."""
        return len(self.velocity)

    @property
    def solved(self) -> BoolArray:
        """Which intervals were solved, (T - 1,): fields of the others are 0, as of a film that was
        cancelled before them, and say nothing of speed.
        """
        return np.array([not is_unsolved(verdict) for verdict in self.verdicts])

    def arrays(self) -> dict[str, Any]:
        """Return what files hold."""
        return {name: np.asarray(array) for name, array in results.made(self._parts()).items()}

    def _parts(self) -> results.Parts:
        film = self._frames
        parts: dict[str, Callable[[], Mapping[str, Any]]] = {
            "the mesh": lambda: results.mesh_arrays(self.mesh),
            "frames": lambda: {"frames": film.values},
            "parameters": lambda: {"parameters": json.dumps(self.parameters.to_dict())},
            "verdicts": lambda: {"verdicts": [verdict.texts for verdict in self.verdicts]},
            "mask": lambda: {} if film.mask is None else {"mask": film.mask},
            "notes": lambda: {"notes": np.array(film.notes)} if film.notes else {},
        }
        of_frames, own = (
            ("times", "unit_of_time", "weights", "channels_given"),
            ("velocity", *_NUMBERS),
        )
        for each, names in ((film, of_frames), (self, own)):
            parts |= {name: partial(_array, each, name) for name in names}
        return parts

    @classmethod
    def of_arrays(cls, arrays: results.Arrays) -> Self:
        """Return what has these arrays; ValueError if they do not fit."""
        if not (np.diff(arrays["times"]) > 0).all():
            raise ValueError("times do not ascend")
        fields, frames = (len(arrays[name]) for name in ("velocity", "times"))
        if fields != frames - 1:
            raise ValueError(f"{fields} fields for {frames} frames; expected one less")
        film = Frames(
            results.mesh_of(arrays),
            arrays["frames"],
            arrays["times"],
            arrays.get("mask"),
            arrays["weights"],
            bool(arrays["channels_given"]),
            tuple(arrays["notes"].tolist()) if "notes" in arrays else (),
            str(arrays["unit_of_time"]),
        )
        verdicts = map(Verdict.of_texts, arrays["verdicts"].tolist())
        names = ("velocity", "energies", "residual", "verified_residual", "folded")
        return cls(
            _frames=film,
            parameters=SequenceParameters(**from_json(str(arrays["parameters"]))),
            gamma=float(arrays["gamma"]),
            sigma=float(arrays["sigma"]),
            noise=float(arrays["noise"]),
            motion_share=float(arrays["motion_share"]),
            has_motion=bool(arrays["has_motion"]),
            verdicts=tuple(verdicts),
            **{name: arrays[name] for name in names},
        )

    def save(self, path: File) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError."""
        results.save_arrays(path, self.arrays(), results.SEQUENCE)

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write what can be written of a sequence that `save` refuses, at least its frames and
        fields; return what is missing and why, a line each, or raise ResultError.
        """
        count = len(self.velocity)
        unknown = np.full(count, np.nan)
        verdict = Verdict(Outcome.NOT_REACHED, "", "", cause=Cause.INCONSISTENT)
        substitutes = {
            "gamma": 0.0,
            "sigma": np.nan,
            "noise": 0.0,
            "motion_share": np.nan,
            "has_motion": True,
            "energies": np.full((count, 2, 3), np.nan),
            "residual": unknown,
            "verified_residual": unknown,
            "folded": unknown,
            "verdicts": [verdict.texts] * count,
        }
        return results.save_parts(path, self._parts(), substitutes, results.SEQUENCE)


def _array(of: Frames | Solution, name: str) -> dict[str, Any]:
    return {name: getattr(of, name)}

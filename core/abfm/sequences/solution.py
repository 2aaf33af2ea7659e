"""The data of a solved sequence and its file, one ``.npz`` of plain arrays without pickles."""

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
from abfm.types import BoolArray, File, FloatArray, IntArray
from abfm.wording import counted

_NUMBERS = (
    *("gamma", "sigma", "noise", "motion_share", "has_motion"),
    *("energies", "residual", "verified_residual", "folded"),
)


@dataclass(frozen=True, eq=False)
class Solution:
    """Frames of a function, and the field of each interval between two of them.

    Its attributes are described in `abfm.Sequence`.
    """

    _frames: Frames = field(repr=False)
    velocity: FloatArray = field(repr=False)
    parameters: SequenceParameters = field(repr=False)
    gamma: float
    sigma: float
    energies: FloatArray = field(repr=False)  # (T - 1, 2, 3), energies of `IntervalMeasures`
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
        return self._frames.notes

    @property
    def frames(self) -> FloatArray:
        return self._frames.values

    @property
    def times(self) -> FloatArray:
        return self._frames.times

    @property
    def numbers(self) -> IntArray:
        return self._frames.numbers

    @property
    def unit_of_time(self) -> str:
        """Unit of the times: ``s``, or empty if they are frame numbers."""
        return self._frames.unit_of_time

    def __len__(self) -> int:
        return len(self.velocity)

    @property
    def solved(self) -> BoolArray:
        """Mask (T - 1,) of the solved intervals.

        Other intervals, for example after a cancelled run, have fields of 0, which are not a
        measured speed.
        """
        return np.array([not is_unsolved(verdict) for verdict in self.verdicts])

    def arrays(self) -> dict[str, Any]:
        return {
            name: np.asarray(array) for name, array in results.all_arrays(self._parts()).items()
        }

    def _parts(self) -> results.Parts:
        frames = self._frames
        parts: dict[str, Callable[[], Mapping[str, Any]]] = {
            "the mesh": lambda: results.mesh_arrays(self.mesh),
            "frames": lambda: {"frames": frames.values},
            "parameters": lambda: {"parameters": json.dumps(self.parameters.to_dict())},
            "verdicts": lambda: {"verdicts": [verdict.texts for verdict in self.verdicts]},
            "mask": lambda: {} if frames.mask is None else {"mask": frames.mask},
            "notes": lambda: {"notes": np.array(frames.notes)} if frames.notes else {},
        }
        frame_names = ("times", "numbers", "unit_of_time", "weights", "channels_given")
        local_names = ("velocity", *_NUMBERS)
        for each, names in ((frames, frame_names), (self, local_names)):
            parts |= {name: partial(_array, each, name) for name in names}
        return parts

    @classmethod
    def of_arrays(cls, arrays: results.Arrays) -> Self:
        """Return a solution from the arrays of a file; raise ValueError if they do not fit."""
        if not (np.diff(arrays["times"]) > 0).all():
            raise ValueError("times are not strictly increasing")
        field_count, frame_count = (len(arrays[name]) for name in ("velocity", "times"))
        if field_count != frame_count - 1:
            raise ValueError(
                f"it has {counted(field_count, 'field')} for {counted(frame_count, 'frame')}; "
                "expected one field less"
            )
        frames = Frames(
            results.mesh_of(arrays),
            arrays["frames"],
            arrays["times"],
            arrays.get("mask"),
            arrays["weights"],
            bool(arrays["channels_given"]),
            arrays["numbers"],
            tuple(arrays["notes"].tolist()) if "notes" in arrays else (),
            str(arrays["unit_of_time"]),
        )
        verdicts = map(Verdict.of_texts, arrays["verdicts"].tolist())
        names = ("velocity", "energies", "residual", "verified_residual", "folded")
        return cls(
            _frames=frames,
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
        """Write the ``.npz`` file atomically, without pickles; raise ResultError on failure."""
        results.save_arrays(path, self.arrays(), results.SEQUENCE)

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write all parts that can be written, at least frames and fields, if `save` fails.

        Returns a line for each missing part, with the reason; raises ResultError if not even frames
        and fields can be written.
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

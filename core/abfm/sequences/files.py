"""Files of sequences: one ``.npz`` of plain arrays, no pickles."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm.io import results
from abfm.matching.judging.cause import Cause
from abfm.matching.judging.verdict import Verdict
from abfm.outcome import Outcome
from abfm.reading import from_json
from abfm.sequences.frames import Frames
from abfm.sequences.parameters import SequenceParameters

if TYPE_CHECKING:
    from abfm.mesh import TriangleMesh
    from abfm.sequences.sequence import Sequence

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


def sequence_arrays(sequence: Sequence) -> dict[str, Any]:
    """Return what files hold of a sequence."""
    return {name: np.asarray(array) for name, array in results.made(_parts(sequence)).items()}


def _parts(sequence: Sequence) -> results.Parts:
    film = sequence._frames
    parts: dict[str, Callable[[], Mapping[str, Any]]] = {
        "the mesh": lambda: results.mesh_arrays(sequence.mesh),
        "frames": lambda: {"frames": film.values},
        "parameters": lambda: {"parameters": json.dumps(sequence.parameters.to_dict())},
        "verdicts": lambda: {"verdicts": [verdict.texts for verdict in sequence.verdicts]},
        "mask": lambda: {} if film.mask is None else {"mask": film.mask},
        "notes": lambda: {"notes": np.array(film.notes)} if film.notes else {},
    }
    of_frames, own = ("times", "weights", "channels_given"), ("velocity", *_NUMBERS)
    for each, names in ((film, of_frames), (sequence, own)):
        parts |= {name: partial(_array, each, name) for name in names}
    return parts


def _array(of: Frames | Sequence, name: str) -> dict[str, Any]:
    return {name: getattr(of, name)}


def save_parts(sequence: Sequence, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write what can be written of a sequence that `Sequence.save` refuses, at least its frames and
    fields; return what is missing and why, a line each, or raise ResultError.
    """
    count = len(sequence.velocity)
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
    return results.save_parts(path, _parts(sequence), substitutes, results.SEQUENCE)


def is_sequence(path: str | os.PathLike[str]) -> bool:
    """Tell whether a file is one of `Sequence.save`; ResultError if it cannot be read."""
    with results.open_archive(path, results.SEQUENCE.name, results.MEND) as archive:
        return results.is_own(archive) and "frames" in archive and "velocity" in archive


def load_sequence(path: str | os.PathLike[str]) -> Sequence:
    """Read a file of `Sequence.save`; ResultError if it is missing, damaged, or none."""
    return results.loaded(path, results.SEQUENCE, sequence_of)


def sequence_of(arrays: results.Arrays, mesh: TriangleMesh | None = None) -> Sequence:
    """Return the sequence of `sequence_arrays`, on their mesh, or the same one that is there;
    ValueError if they do not fit.
    """
    from abfm.sequences.sequence import Sequence

    if not (np.diff(arrays["times"]) > 0).all():
        raise ValueError("times do not ascend")
    if len(arrays["velocity"]) != len(arrays["times"]) - 1:
        raise ValueError(
            f"{len(arrays['velocity'])} fields for {len(arrays['times'])} frames; expected one less"
        )
    mesh = mesh or results.mesh_of(arrays)
    frames = Frames(
        mesh,
        arrays["frames"],
        arrays["times"],
        arrays.get("mask"),
        arrays["weights"],
        bool(arrays["channels_given"]),
        tuple(arrays["notes"].tolist()) if "notes" in arrays else (),
    )
    verdicts = map(Verdict.of_texts, arrays["verdicts"].tolist())
    names = ("velocity", "energies", "residual", "verified_residual", "folded")
    return Sequence(
        _frames=frames,
        parameters=SequenceParameters.of(**from_json(str(arrays["parameters"]))),
        gamma=float(arrays["gamma"]),
        sigma=float(arrays["sigma"]),
        noise=float(arrays["noise"]),
        motion_share=float(arrays["motion_share"]),
        has_motion=bool(arrays["has_motion"]),
        verdicts=tuple(verdicts),
        **{name: arrays[name] for name in names},
    )

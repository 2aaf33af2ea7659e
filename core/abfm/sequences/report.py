"""The report of a sequence: JSON values and lines of text."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from abfm.calculus.operators import face_areas, gradient
from abfm.matching.judging.facts import finite, headline_of
from abfm.outcome import worse_residual
from abfm.sequences.sequence import Sequence
from abfm.sequences.tracking.critical_points import KINDS
from abfm.sequences.verdicts import is_unsolved
from abfm.types import BoolArray, FloatArray
from abfm.wording import counted, share

TRACK_INTERVALS_MIN = 3
EPISODES_SHOWN_MAX = 8


def details(sequence: Sequence) -> dict[str, Any]:
    """Return the reported values of a sequence as numbers and texts; unknown values are None."""
    speed, steep = _speeds(sequence), _steep(sequence)
    return {
        "vertices": len(sequence.mesh.vertices),
        "faces": len(sequence.mesh.faces),
        "frames": len(sequence.frames),
        "channels": sequence.frames.shape[2],
        "frame_numbers": sequence.numbers.tolist(),
        "times": sequence.times.tolist(),
        "unit_of_time": sequence.unit_of_time or None,
        "order": sequence.parameters.order,
        "alpha": sequence.parameters.alpha,
        "sigma": finite(sequence.sigma),
        "gamma": sequence.gamma,
        "noise": sequence.noise,
        "motion_share": finite(sequence.motion_share),
        "has_motion": sequence.has_motion,
        "intervals": len(sequence),
        "solved": int(sequence.solved.sum()),
        "confirmed": sequence.confirmed,
        "speed": {
            "median": float(np.median(speed)) if speed.size else None,
            "median_where_steep": float(np.median(speed[steep])) if steep.any() else None,
            "maximum": float(speed.max()) if speed.size else None,
        },
        "uncertainty": [finite(each) for each in sequence.speed_uncertainty.tolist()],
        "determined": sequence.speed_determined.tolist(),
        "residual": [finite(each) for each in sequence.residual.tolist()],
        "verified_residual": [finite(each) for each in sequence.verified_residual.tolist()],
        "folded": [finite(each) for each in sequence.folded.tolist()],
        "verdicts": [verdict.kind for verdict in sequence.verdicts],
        "tracks": _tracks(sequence),
        "episodes": [asdict(episode) for episode in sequence.episodes()],
        "parameters": sequence.parameters.to_dict(),
        "messages": list(sequence.mesh.messages),
    }


def lines(sequence: Sequence) -> list[str]:
    unit = "second" if sequence.unit_of_time else "frame"
    times, speed, steep = sequence.times, _speeds(sequence), _steep(sequence)
    where_steep = ""
    if steep.any():
        where_steep = f"{np.median(speed[steep]):.3g} where the frames have a steep gradient, "
    others = Counter(
        "not solved" if is_unsolved(verdict) else verdict.kind for verdict in sequence.verdicts
    )
    kinds = ", ".join(f"{count} {kind}" for kind, count in others.most_common())
    tracks = [counted(count, kind) for kind, count in _tracks(sequence).items() if count]
    is_cancelled = not sequence.facts.is_complete
    found = [
        *(["cancelled: unsolved intervals have no motion"] if is_cancelled else []),
        f"{sequence.confirmed} of {counted(len(sequence), 'interval')} confirmed by flow lines: "
        f"{kinds}",
        f"{counted(len(times), 'frame')} from {times[0]:.6g} to {times[-1]:.6g}, on a mesh of "
        f"{len(sequence.mesh.faces):,} faces; {sequence.settings}; residual of noise "
        f"{sequence.noise:.2g}",
        f"speed: median {where_steep}{np.median(speed):.3g} everywhere, at most "
        f"{speed.max():.3g}, in the mesh's unit per {unit}"
        if speed.size
        else "speed: unknown, as no interval was solved",
        f"tracks through {TRACK_INTERVALS_MIN} intervals or more: {', '.join(tracks) or 'none'}",
        *([f"uncertainty: {uncertainty_text(sequence)}"] if speed.size else []),
        f"frames in between: {motion_text(sequence)}",
    ]
    if episodes := sequence.episodes():
        shown = episodes[:EPISODES_SHOWN_MAX]
        parts = [f"{each.kind} from {each.start:.4g} to {each.end:.4g}" for each in shown]
        omitted = len(episodes) - len(shown)
        found.append(f"episodes: {', '.join([*parts, *([f'{omitted} more'] if omitted else [])])}")
    return found


def _speeds(sequence: Sequence) -> FloatArray:
    return np.asarray(np.linalg.norm(sequence.velocity[sequence.solved], axis=2))


def _steep(sequence: Sequence) -> BoolArray:
    """Return a mask (S, F) of the faces on which the first frame of each solved interval is steep.

    There the gradient exceeds its root mean square; elsewhere smoothness determines the field.
    """
    mesh = sequence.mesh
    areas, derive = face_areas(mesh), gradient(mesh)
    found = []
    for frame in sequence.frames[:-1][sequence.solved]:
        squares = ((derive @ frame).reshape(len(mesh.faces), -1) ** 2).sum(axis=1)
        found.append(squares > areas @ squares / areas.sum())
    return np.array(found, dtype=bool).reshape(-1, len(mesh.faces))


def _tracks(sequence: Sequence) -> dict[str, int]:
    counts = Counter(track.kind for track in sequence.tracks(TRACK_INTERVALS_MIN))
    return {kind: counts[kind] for kind in KINDS}


def interval_headline(sequence: Sequence, interval: int) -> str:
    """Return the headline of an interval of a sequence, such as ``matched (residual 0.7%)``."""
    residual = worse_residual(
        float(sequence.residual[interval]), float(sequence.verified_residual[interval])
    )
    return headline_of(sequence.verdicts[interval].kind, residual, sequence.parameters.goal)


def motion_text(sequence: Sequence) -> str:
    """Return the share of motion in interpolated frames as text, with a reason if there is none."""
    found = sequence.motion_share
    if math.isnan(found):
        why = "held-out frames neither confirm nor refute motion"
        if len(sequence) < 2:
            why = "there is no frame between two frames to hold out"
        return f"motion in confirmed intervals, else the linear blend, as {why}"
    if found == 0:
        why = "noise hides the motion" if sequence.has_motion else "held-out frames show no motion"
        return f"the linear blend, as {why}"
    return f"moved by {share(found)} of the motion, the share that best predicts held-out frames"


def uncertainty_text(sequence: Sequence) -> str:
    """Return the median standard error of the fields, and the determined share, as text."""
    solved = sequence.solved
    error = float(np.median(sequence.speed_uncertainty[solved]))
    if not math.isfinite(error):
        return "infinite, as the frames determine no motion"
    found = float(np.median(sequence.speed_determined[solved]))
    return f"median {error:.3g}; the frames determine {share(found)} of the field"

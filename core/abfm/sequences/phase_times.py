"""Usual durations of the phases of a sequence, for estimates of its remaining time."""

from abfm.sequences.frames import Frames
from abfm.workers.progress import usual_seconds

_PHASES = (
    "choosing sigma",
    "following the frames",
    "tracing flow lines",
    "smoothing in time",
    "holding out frames",
    "checking by flow lines",
)


def work_of(frames: Frames) -> int:
    """Return the amount of work of a phase, which determines its usual duration."""
    return len(frames.mesh.vertices) * len(frames.durations)


def seconds_after(phase: str, frames: Frames) -> float:
    """Return the usual duration, in seconds, of the phases that follow a phase."""
    later = _PHASES[_PHASES.index(phase) + 1 :]
    return sum(usual_seconds(each, work_of(frames)) or 0.0 for each in later)

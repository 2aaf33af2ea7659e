"""Usual durations of the phases of a sequence, for estimates of its remaining time."""

from abfm.sequences.frames import Frames

# seconds of all phases after each phase, per vertex and interval
_SECONDS_AFTER = {
    "choosing sigma": 5e-5,
    "following the frames": 3e-5,
    "tracing flow lines": 2.5e-5,
    "smoothing in time": 1.5e-5,
    "correcting by flow lines": 1.5e-5,
    "holding out frames": 1e-5,
}


def seconds_after(phase: str, frames: Frames) -> float:
    """Return the usual duration, in seconds, of the phases that follow a phase."""
    return _SECONDS_AFTER[phase] * len(frames.mesh.vertices) * len(frames.durations)

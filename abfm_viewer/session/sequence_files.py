"""Documents of a sequence of frames on a mesh, and of a match between two of the frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Channel, Surface, View
from abfm_viewer.document.frame_sequence import FrameSequence
from abfm_viewer.document.kinds import MEASURED_COLUMN, MatchDocument, SequenceDocument


def read_frame_sequence(
    path: Path, mesh: TriangleMesh, array: str | None = None
) -> tuple[FrameSequence, tuple[str, ...]]:
    """Read a sequence of frames on a mesh from a file, and return it with notes for the user.

    A file without frames for the mesh raises a `FunctionError`. A file with several arrays raises a
    `SeveralArraysError` unless ``array`` names one of them.
    """
    from abfm.sequences.frames import check_frames  # loads many modules

    found = abfm.sequences.read_frames(path, mesh, array)
    frames = check_frames(mesh, found.values, found.times, None, None)
    return FrameSequence(path.name, frames), (*found.notes, *frames.notes)


def circular_sequence(sequence: FrameSequence, period: float | None) -> FrameSequence:
    """Return a sequence of phases as cosine and sine, so that it can be matched across the period.

    If ``period`` is None, return the phases of such a sequence.
    """
    from abfm.sequences.frames import check_frames  # loads many modules

    if sequence.phases is not None:
        phases = replace(sequence.phases, times=sequence.times, unit_of_time=sequence.unit)
        sequence = replace(sequence, frames=phases, phases=None)
    if period is None:
        return sequence
    frames = sequence.frames
    values = frames.values.copy()
    if frames.unknown is not None:
        values[:, frames.unknown] = np.nan
    circle, weights = abfm.functions.as_circle(values, period), np.repeat(frames.weights, 2)
    made = check_frames(frames.mesh, circle, frames.times, frames.mask, weights)
    made = replace(made, unit_of_time=sequence.unit, numbers=frames.numbers, notes=frames.notes)
    return replace(sequence, frames=made, phases=frames)


def document_of_frames(sequence: FrameSequence, surface: Surface, view: View) -> SequenceDocument:
    """Return a document of a sequence at its first frame; its front shows most of the changes."""
    without_front = replace(surface, front=None)
    return SequenceDocument((without_front,), sequence, time=float(sequence.times[0]), view=view)


def document_of_pair(
    document: SequenceDocument, first: int, last: int
) -> tuple[MatchDocument, dict[str, FloatArray]]:
    """Return a document that matches two frames, given by index, and the values of both."""
    sequence = document.sequence
    known: dict[str, FloatArray] = {}
    display_names: dict[str, str] = {}

    def spec(name: str, values: FloatArray) -> str:
        text = str(abfm.functions.ValuesFile(path=sequence.name, column=name))
        known[text], display_names[text] = values, name
        return text

    channels = []
    for number, weight in enumerate(sequence.frames.weights.tolist()):
        suffix = f", channel {number}" if sequence.channels > 1 else ""
        source, target = (
            spec(f"frame {sequence.numbers[k]}{suffix}", sequence.columns[k][number])
            for k in (first, last)
        )
        channels.append(Channel(source, target, weight))
    mask = "" if sequence.frames.mask is None else spec(MEASURED_COLUMN, sequence.frames.mask)
    made = MatchDocument(
        document.surfaces,
        tuple(channels),
        mask=mask,
        channel=document.channel,
        display_names=display_names,
        view=document.view,
    )
    return made, known

"""The task of finding the fields between the frames of a sequence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from abfm.errors import ColumnError, ParameterError, brief
from abfm.io import check_stc_name, check_values_name, even_step, results
from abfm.matching.judging.verdict import Verdict
from abfm.matching.terms.functions import mask_from_input
from abfm.mesh import TriangleMesh
from abfm.outcome import Facts
from abfm.reading import FRAMES_ENDINGS
from abfm.sequences import report
from abfm.sequences.checkpoint_file import SequenceCheckpoint
from abfm.sequences.exports import (
    check_pvd,
    export_intervals,
    export_pvd,
    export_speed,
    export_stc,
    export_tracks,
)
from abfm.sequences.frames import have_values, notes_on_omitted
from abfm.sequences.parameters import AUTOMATIC_NAMES, PARAMETER_NAMES, defaults
from abfm.sequences.reading.frames_file import FramesFile
from abfm.sequences.reading.reading_frames import read_frames
from abfm.sequences.sequence import GAMMA, GAMMA_MAX, Sequence, load_sequence, sequence
from abfm.sequences.verdicts import NUMBERS, facts_of_intervals
from abfm.tasks.inputs import (
    CIRCULAR_INPUT,
    FUNCTIONS_HELP,
    MESH_FORMATS,
    MESH_INPUTS,
    Input,
    channel_input,
    channel_words,
    file_input,
    mask_input,
    number_input,
    parameter_inputs,
    parameters_in,
    read_number,
)
from abfm.tasks.meshes import mesh_notes, mesh_of
from abfm.tasks.monitor import Monitor
from abfm.tasks.task import Export, Preview, Report, ResultFile, Table, Task, TaskInputs, preview_of
from abfm.types import BoolArray, FloatArray
from abfm.wording import counted

SECONDS_MAX = 86400.0
_FRAMES = "frames"
_CHANNEL = "NUMBER WEIGHT"
_DEFAULTS = {name: getattr(defaults(), name) for name in PARAMETER_NAMES} | dict.fromkeys(
    AUTOMATIC_NAMES
)
_PARAMETER_HELP = {
    "alpha": "smoothness of the fields, the weight of their Hodge Laplacian; auto: chosen by "
    "held-out patches of a few intervals",
    "order": "order of the norm of the fields; 1 as in the paper, 2 for smoother fields; auto: "
    "chosen by held-out patches",
    "sigma": "weight of the smoothness, in standard deviations of the frames; smaller values match "
    "more closely; auto: the largest that predicts held-out patches nearly best",
    "sigma_unit": "unit of sigma: relative to the L2 deviation of the frames from their mean, or "
    "absolute as in the paper",
}


def _channel(text: str) -> tuple[int, float]:
    number, weight = channel_words(text, _CHANNEL)
    if not number.isdecimal():
        raise ParameterError(f"{brief(number)} is not the number of a channel, counted from 0")
    return int(number), read_number(weight, "of at least 0, the weight", lambda value: value >= 0)


def _channel_weights(channels: Iterable[tuple[int, float]], count: int) -> list[float]:
    """Return weights of ``count`` channels from pairs of index and weight; others have weight 1."""
    weights = [1.0] * count
    for number, weight in channels:
        if number >= count:
            raise ParameterError(
                f"there is no channel {number}: the frames have {counted(count, 'channel')}, "
                "counted from 0"
            )
        weights[number] = weight
    return weights


def _facts_of_file(path: Path) -> Facts:
    entries = {name: results.SEQUENCE.entries[name] for name in ("verdicts", *NUMBERS)}
    with results.open_archive(path, results.SEQUENCE.name, results.REMEDY) as archive:
        texts, *numbers = results.check_arrays(archive, entries).values()
        return facts_of_intervals(list(map(Verdict.of_texts, texts.tolist())), *numbers)


def _preview(path: Path) -> Preview:
    return preview_of(
        path,
        results.SEQUENCE,
        lambda arrays: [arrays["frames"][i, :, 0] for i in (0, len(arrays["frames"]) // 2, -1)],
    )


_DESCRIPTION = """\
Find the motion in a sequence of frames of a function on a mesh, as optical flow on a surface. For
each interval, this is the tangent vector field whose flow transports one frame to the next.

Examples:
  abfm sequence lh.pial wave.npy --dt 0.001 --out wave.npz --out wave.html
  abfm sequence fsaverage5_left.gii bold.func.gii --mask cortex.csv --out bold.npz --out bold.pvd
  abfm sequence lh.white sources-lh.stc --out flow.npz --out speed-lh.stc --tracks tracks.csv
  abfm sequence mesh.ply simulation.pvd --array u --gamma 0 --out s.npz

The exit status is 0 if flow lines confirm at least half of the intervals, 3 if they confirm fewer,
2 for bad input.
"""
_DETAILS = f"""\
Frames:
  - an array (T, V) or (T, V, C) in .npy, .mat or .npz ("frames", optionally "times")
  - a table, GIFTI, CIFTI or .mgh file with one column per frame
  - one hemisphere of a source estimate of MNE (.stc)
  - .pvd, .series, or one of numbered .vtu, .vtp or .vtk files
Rows with a vertex number are assigned to that vertex.

Fields of neighbouring intervals are coupled (--gamma). Flow lines verify each field.

{FUNCTIONS_HELP}
Exit status:
  0    flow lines confirm at least half of the intervals
  2    bad input
  3    flow lines confirm fewer intervals
  130  Ctrl-C ended the run (143: SIGTERM, 129: closed terminal); finished intervals are written,
       and the fields of the others are 0
A checkpoint, FILE-*.unfinished next to the first output, exists until the result is complete. The
same command resumes from it.
"""


@dataclass(frozen=True)
class SequenceTask(Task):
    """The task of finding the fields whose flows map each frame of a sequence to the next.

    Attributes
    ----------
    mesh : TriangleMesh
    frames : FramesFile
    key : str
        Name of the result.
    dt : float, optional
        Seconds between two frames, which replace the times of the file.
    options : mapping of str
        Further arguments of `abfm.sequence`.
    """

    mesh: TriangleMesh
    frames: FramesFile
    key: str
    dt: float | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    kind: ClassVar = "sequence"
    summary: ClassVar = "find the motion in a sequence of frames on a mesh"
    description: ClassVar = _DESCRIPTION
    details: ClassVar = _DETAILS
    output_help: ClassVar = (
        "sequence (.npz), interactive page (.html), ParaView collection with a folder of .vtu "
        "files (.pvd), or the speed at vertices (-lh.stc, -rh.stc, .func.gii)"
    )
    needs: ClassVar = ("frames", "mesh")
    inputs: ClassVar = (
        file_input("mesh", MESH_FORMATS, "MESH", is_argument=True),
        file_input(
            "frames", f"file of frames: {', '.join(FRAMES_ENDINGS)}", "FRAMES", is_argument=True
        ),
        number_input(
            "dt",
            "seconds between two frames (default: as in the file, or 1)",
            "SECONDS",
            f"above 0 and at most {SECONDS_MAX:g}",
            lambda seconds: 0 < seconds <= SECONDS_MAX,
            group=_FRAMES,
        ),
        channel_input(
            "weight of a channel of the frames, counted from 0; the others have weight 1",
            _CHANNEL,
            _channel,
        ),
        CIRCULAR_INPUT,
        Input(
            name="array",
            help="name of the array in a .npz, .mat or .ply file, or in the point data of VTK",
            metavar="NAME",
            group=_FRAMES,
        ),
        mask_input("mask", "weight of the mismatch at each vertex (0: value unknown)"),
        number_input(
            "gamma",
            "coupling of neighbouring intervals: weight of the difference of their fields; 0 "
            "solves each interval independently",
            "X",
            f"from 0 to {GAMMA_MAX:g}",
            lambda gamma: 0 <= gamma <= GAMMA_MAX,
            group="smoothness in time",
            default=f"{GAMMA:g}",
        ),
        *parameter_inputs(_DEFAULTS, _PARAMETER_HELP),
        *MESH_INPUTS,
    )
    main_options: ClassVar = (
        *("dt", "array", "channel", "circular", "mask"),
        *("gamma", "alpha", "sigma", "set", "tracks"),
    )
    result: ClassVar = Sequence
    file: ClassVar = ResultFile(
        frozenset({"frames", "velocity"}), load_sequence, _facts_of_file, _preview
    )
    report: ClassVar = Report(report.details, report.lines)
    preview_labels: ClassVar = ("first frame", "middle frame", "last frame")
    exports: ClassVar = {
        ".pvd": Export(export_pvd, check_pvd),
        ".stc": Export(export_stc, check_stc_name),
        ".gii": Export(export_speed, check_values_name),
    }
    tables: ClassVar = {
        "tracks": Table("table of critical points through time", export_tracks),
        "intervals": Table(
            "table of the intervals: speed, uncertainty, residuals, verdict", export_intervals
        ),
    }

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Raise an error for parameters that sequences do not support, or that are inconsistent."""
        defaults(**parameters_in(values))
        numbers = [number for number, _ in values.get("channel", ())]
        for number in numbers:
            if numbers.count(number) > 1:
                raise ColumnError("channel", f": {number} is given twice")

    @classmethod
    def read(cls, given: TaskInputs) -> SequenceTask:
        values = given.values()
        mesh = mesh_of(values["mesh"], values)
        options = {
            "parameters": defaults(**parameters_in(values)),
            "gamma": values.get("gamma", GAMMA),
            "mask": mask_from_input(mesh, values.get("mask")),
            "circular": values.get("circular", False),
        }
        frames = read_frames(values["frames"], mesh, values.get("array"))
        if channels := values.get("channel"):
            count = frames.values.shape[2] if frames.values.ndim == 3 else 1
            options["weights"] = _channel_weights(channels, count)
        return cls(mesh, frames, given.key, values.get("dt"), options)

    @property
    def times(self) -> FloatArray | None:
        """Times of the frames, (T,); None if they are unknown."""
        if self.dt is None:
            return self.frames.times
        return self.dt * np.arange(len(self.frames.values), dtype=np.float64)

    @property
    def _have_values(self) -> BoolArray:
        return have_values(self.frames.values, self.options.get("weights"))

    def solve(self, monitor: Monitor) -> Sequence:
        count = int(self._have_values.sum()) - 1
        checkpoint = SequenceCheckpoint(
            monitor.checkpoint,
            lambda found: monitor.on_note(
                f"resuming after {found} of {count} intervals, which an earlier run solved"
            ),
            not monitor.resumes_only,
        )
        found = sequence(
            self.mesh,
            self.frames.values,
            self.times,
            **self.options,
            checkpoint=checkpoint,
            on_field=lambda interval, field: monitor.on_partial((interval, field)),
            control=monitor.control,
        )
        if checkpoint.path is not None:
            monitor.checkpoints.append(checkpoint.path)
        return found

    def notes(self) -> list[str]:
        notes = [*mesh_notes(self.mesh), *self.frames.notes, *notes_on_omitted(self._have_values)]
        if self.times is None:
            notes.append("the file has no times; frames get the times 0, 1, 2, ... (set --dt)")
        return notes

    def check_export(self, path: Path) -> None:
        if path.suffix == ".stc" and self.times is not None:
            times = self.times[self._have_values]
            even_step(path, (times[1:] + times[:-1]) / 2)

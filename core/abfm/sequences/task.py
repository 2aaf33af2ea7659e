"""The task of finding the fields between the frames of a sequence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from abfm.errors import ParameterError, brief
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
from abfm.sequences.parameters import AUTOMATIC_NAMES, PARAMETER_NAMES, defaults
from abfm.sequences.reading.frames_file import FramesFile
from abfm.sequences.reading.reading_frames import read_frames
from abfm.sequences.sequence import GAMMA, GAMMA_MAX, Sequence, load_sequence, sequence
from abfm.sequences.verdicts import NUMBERS, facts_of_intervals
from abfm.tasks.inputs import (
    CIRCULAR_INPUT,
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
from abfm.types import FloatArray
from abfm.wording import counted

SECONDS_MAX = 86400.0
_FRAMES = "frames"
_CHANNEL = "NUMBER WEIGHT"
_DEFAULTS = {name: getattr(defaults(), name) for name in PARAMETER_NAMES} | dict.fromkeys(
    AUTOMATIC_NAMES
)
_PARAMETER_HELP = {
    "alpha": "smoothness of the fields: weight of their Hodge Laplacian; not given, chosen by "
    "held-out patches of a few intervals",
    "order": "order of the norm of the fields: 1, the paper's, or 2, which is smoother; not given, "
    "chosen by held-out patches",
    "sigma": "weight of the match against the smoothness, in deviations of the frames: smaller "
    "matches closer; not given, the largest that predicts held-out patches nearly as well as any",
    "sigma_unit": "sigma in deviations of the frames from their mean in L2, or as in the paper",
}


def _channel(text: str) -> tuple[int, float]:
    number, weight = channel_words(text, _CHANNEL)
    if not number.isdecimal():
        raise ParameterError(f"{brief(number)} is not the number of a channel, counted from 0")
    return int(number), read_number(weight, "of at least 0, the weight", lambda value: value >= 0)


def _channel_weights(channels: Iterable[tuple[int, float]], count: int) -> list[float]:
    """Return the weight of each channel of frames; 1 for those that are not given."""
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
    """Return the facts in the file of a sequence, as `abfm.Sequence.facts`."""
    entries = {name: results.SEQUENCE.entries[name] for name in ("verdicts", *NUMBERS)}
    with results.open_archive(path, results.SEQUENCE.name, results.MEND) as archive:
        texts, *numbers = results.check_arrays(archive, entries).values()
        return facts_of_intervals(list(map(Verdict.of_texts, texts.tolist())), *numbers)


def _preview(path: Path) -> Preview:
    """Return the first, the middle and the last frame of a sequence."""
    return preview_of(
        path,
        results.SEQUENCE,
        lambda arrays: [arrays["frames"][i, :, 0] for i in (0, len(arrays["frames"]) // 2, -1)],
    )


_DESCRIPTION = """\
Find, for each two frames of a function that changes in time, the vector field whose flow carries
the one to the other: optical flow on a surface. Fields of neighbouring intervals are held together,
and each is checked by flow lines.

Examples:
  abfm sequence lh.pial wave.npy --dt 0.001 --out wave.npz --out wave.html
  abfm sequence fsaverage5_left.gii bold.func.gii --mask cortex.csv --out bold.npz --out bold.pvd
  abfm sequence lh.white sources-lh.stc --out flow.npz --out speed-lh.stc --tracks tracks.csv
  abfm sequence mesh.ply simulation.pvd --array u --gamma 0 --out s.npz

Frames are an array (T, V) or (T, V, C) in .npy, .npz ("frames", and perhaps "times") or .mat, a
table, GIFTI, CIFTI or .mgh file with a column for each, one hemisphere of MNE's .stc, or ParaView's
.pvd, .series, or one of numbered .vtu, .vtp or .vtk files. Rows that name their vertex are placed.

The exit status is 0 when flow lines confirm at least half of the intervals, 3 when they confirm
fewer, 2 for bad input, and 130 or 143 when Ctrl-C or SIGTERM ended the run: what was found is
written, and the fields of other intervals are 0. Beside the first output, a file FILE-*.unfinished
keeps what is found until all is written: the same command goes on from it, whatever ended the run.
"""


@dataclass(frozen=True)
class SequenceTask(Task):
    """Find the fields whose flows map each frame of a sequence to the next.

    Attributes
    ----------
    mesh : TriangleMesh
    frames : FramesFile
    key : str
        Name of the result.
    dt : float, optional
        Time between two frames, instead of the times of the file.
    options : mapping of str
        Further arguments of `abfm.sequence`.
    """

    mesh: TriangleMesh
    frames: FramesFile
    key: str
    dt: float | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    kind: ClassVar = "sequence"
    summary: ClassVar = "find the fields that carry each frame of a film on a surface to the next"
    description: ClassVar = _DESCRIPTION
    output_help: ClassVar = (
        "sequence .npz; .html for a browser; .pvd with a folder of .vtu for ParaView; the speed at "
        "vertices as -lh.stc or -rh.stc for MNE, or as .func.gii"
    )
    needs: ClassVar = ("frames", "mesh")
    inputs: ClassVar = (
        file_input("mesh", MESH_FORMATS, "MESH", is_argument=True),
        file_input(
            "frames", f"the frames: {', '.join(FRAMES_ENDINGS)}", "FRAMES", is_argument=True
        ),
        number_input(
            "dt",
            "seconds between two frames, whatever the file says (default: as in the file, or 1)",
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
            help="which array of a .npz, .mat or .ply, or of VTK's point data",
            metavar="NAME",
            group=_FRAMES,
        ),
        mask_input("mask", "weight of the mismatch at each vertex, 0 where values are unknown"),
        number_input(
            "gamma",
            "weight of the difference between the fields of neighbouring intervals; 0 solves each "
            "interval alone",
            "X",
            f"from 0 to {GAMMA_MAX:g}",
            lambda gamma: 0 <= gamma <= GAMMA_MAX,
            group="smoothness in time",
            default=f"{GAMMA:g}",
        ),
        *parameter_inputs(_DEFAULTS, _PARAMETER_HELP),
        *MESH_INPUTS,
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
            "table of the intervals: speed, its uncertainty, residuals and verdict",
            export_intervals,
        ),
    }

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Refuse parameters that sequences do not take, or that do not fit each other."""
        defaults(**parameters_in(values))
        numbers = [number for number, _ in values.get("channel", ())]
        for number in numbers:
            if numbers.count(number) > 1:
                raise ParameterError(f"column channel: {number} is given twice")

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

    def solve(self, monitor: Monitor) -> Sequence:
        count = len(self.frames.values) - 1
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
        notes = [*mesh_notes(self.mesh), *self.frames.notes]
        if self.times is None:
            notes.append("the file has no times; frames are 1 apart. Use --dt to give seconds.")
        return notes

    def check_export(self, path: Path) -> None:
        if path.suffix == ".stc" and self.times is not None:
            even_step(path, (self.times[1:] + self.times[:-1]) / 2)

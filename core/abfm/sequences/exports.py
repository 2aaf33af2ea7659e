"""Export of sequences to ParaView, MNE, Connectome Workbench and tables."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from abfm.calculus.operators import averaging
from abfm.errors import ResultError, one_line
from abfm.flow.flow import Flow
from abfm.io import (
    check_writable,
    export_vtu,
    temporary_folder,
    write_csv,
    write_file,
    write_stc,
    write_values,
)
from abfm.reading import read_collection
from abfm.sequences.sequence import Sequence
from abfm.types import FloatArray
from abfm.wording import counted
from abfm.workers.progress import stepped

_CELL_DATA = ("velocity", "uncertainty", "determined")
_TRACKS = ["track", "kind", "index", "time", "x", "y", "z", "face", "divergence", "curl"]
_INTERVALS = [
    *("interval", "start", "end", "speed", "uncertainty", "determined"),
    *("energy", "residual", "by_flow_lines", "folded", "verdict", "reason"),
]


def vertex_speed(sequence: Sequence) -> FloatArray:
    """Return the speed at vertices in each interval, (T - 1, V): the mean over adjacent faces."""
    mean = averaging(sequence.mesh)
    return np.stack([mean @ np.linalg.norm(field, axis=1) for field in sequence.velocity])


def check_pvd(path: str | os.PathLike[str]) -> Path:
    """Check that `export_pvd` can write to a path; return the folder for the frames.

    Links in the path of the folder are resolved.

    Raises
    ------
    ResultError
        If `export_pvd` could not write to the path.
    """
    path = Path(path)
    if path.suffix != ".pvd":
        raise ResultError(
            f"cannot write {path}: the name of a ParaView collection must end in .pvd"
        )
    folder = Path(os.path.realpath(path.with_suffix("")))
    if folder.exists() and not folder.is_dir():
        raise ResultError(
            f"cannot make the folder {folder}: a file has this name; choose another name"
        )
    check_writable(path)
    if folder.is_dir():
        check_writable(folder / f"{path.stem}_0000.vtu")
    return folder


def export_pvd(path: str | os.PathLike[str], sequence: Sequence) -> None:
    """Write a sequence for ParaView: ``NAME.pvd``, and ``NAME_0000.vtu``, ... in a folder NAME.

    Each frame has these point data:

    - ``frame``: the values of the frame
    - ``advected``: the previous frame advected to the time of this frame
    - ``divergence`` and ``curl`` of the field
    - ``measured``, if values are missing in some frame: 0 where they are filled in, else 1

    Each frame has these cell data:

    - ``velocity``
    - ``uncertainty``: standard error of the velocity, infinite where frames determine no motion
    - ``determined``: share of the squared velocity that the frames determine, from 0 to 1

    A frame has the fields of the interval that begins at it, and the last frame those of the
    interval that ends at it. Files replace older ones only after all are written. If the export is
    cancelled or fails, the folder is unchanged. Surplus frames of an older, longer sequence of the
    same name are removed at the end.

    Raises
    ------
    ResultError
        If the name does not end in ``.pvd``, or a file cannot be written.
    """
    path, folder = Path(path), check_pvd(path)
    old_frames = _listed_frames(path)
    try:
        # on the same disk as the folder, so that files can be moved
        with temporary_folder(folder if folder.is_dir() else folder.parent) as temporary:
            try:
                rows = _write_frames(temporary, path.stem, sequence)
            except ResultError as error:  # its message has the temporary folder, unknown to users
                raise ResultError(str(error).replace(str(temporary), str(folder))) from error
            folder.mkdir(exist_ok=True)
            written = [each.name for each in sorted(temporary.iterdir())]
            for name in written:
                (temporary / name).replace(folder / name)
    except OSError as error:
        raise ResultError(f"cannot write in the folder {folder}: {one_line(error)}") from error
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
        "<Collection>",
        *rows,
        "</Collection>",
        "</VTKFile>",
    ]
    write_file(path, "".join(f"{line}\n" for line in lines))
    for name in old_frames.difference(written):
        with suppress(OSError):
            (folder / name).unlink()


def _listed_frames(path: Path) -> set[str]:
    """Return the names of the .vtu files that an existing .pvd file lists in its folder."""
    pattern = re.compile(f"{re.escape(path.stem)}/({re.escape(path.stem)}_[0-9]{{4,}}\\.vtu)")
    with suppress(OSError, ValueError):
        return {found[1] for _, name in read_collection(path) if (found := pattern.fullmatch(name))}
    return set()


def _write_frames(folder: Path, name: str, sequence: Sequence) -> list[str]:
    """Write a .vtu file per frame; return the .pvd lines that list them in a folder ``name``."""
    rows = []
    advected, unknown = sequence.frames[0], sequence.unknown
    measured = {} if unknown is None else {"measured": (~unknown).astype(np.uint8)}
    with stepped("writing frames", sequence.times.tolist()) as counted_times:
        for k, time in enumerate(counted_times):
            i = min(k, len(sequence) - 1)
            points = {
                **measured,
                "frame": _columns(sequence.frames[k]),
                "advected": _columns(advected),
                "divergence": sequence.divergence[i],
                "curl": sequence.curl[i],
            }
            file = f"{name}_{k:04}.vtu"
            cells = {each: getattr(sequence, each)[i] for each in _CELL_DATA}
            export_vtu(folder / file, sequence.mesh, points, cells)
            rows.append(f'<DataSet timestep="{time!r}" file={quoteattr(f"{name}/{file}")}/>')
            if k < len(sequence):
                duration = float(sequence.times[k + 1]) - time
                flow = Flow(sequence.mesh, sequence.velocity[k], duration)
                advected = flow.push(sequence.frames[k])
    return rows


def _columns(frame: FloatArray) -> FloatArray:
    return frame if frame.shape[1] > 1 else frame[:, 0]


def export_stc(path: str | os.PathLike[str], sequence: Sequence) -> str:
    """Write the speed at all vertices for MNE, with a sample in the middle of each interval.

    The path is ``NAME-lh.stc`` or ``NAME-rh.stc``. See `abfm.io.write_stc` for the file of the
    other hemisphere, the returned note and the errors.
    """
    speed = vertex_speed(sequence)
    numbers, rows = sequence.mesh.numbered
    return write_stc(path, speed[:, rows], numbers, sequence.middles)


def export_speed(path: str | os.PathLike[str], sequence: Sequence) -> None:
    """Write the speed at the vertices of the mesh's file, with a column for each interval.

    The name of a column is the time in the middle of the interval. The formats are GIFTI, .npy,
    .csv and .mgh, see `abfm.io.write_values`. The speed is NaN at vertices without a face.
    """
    speed = sequence.mesh.on_file(vertex_speed(sequence).T)
    names = [f"{time:.9g}" for time in sequence.middles]
    write_values(path, speed, sequence.mesh.structure, names, sequence.middles)


def export_tracks(path: str | os.PathLike[str], sequence: Sequence, min_intervals: int = 3) -> str:
    """Write a .csv of critical points, with a line for each point in each interval.

    The columns are:

    - ``track``: number of the track, from 0
    - ``kind`` and ``index`` of the point, and ``time``, the middle of the interval
    - ``x``, ``y`` and ``z``: position of the point
    - ``face``: index of the face that contains the point
    - ``divergence`` and ``curl`` of the field at the point, per unit of time

    Only tracks through at least ``min_intervals`` intervals are written.

    Returns
    -------
    str
        A note with the number of shorter tracks, which are omitted, or an empty text.

    Raises
    ------
    ResultError
        If the file cannot be written.
    """
    rows, shown = [], sequence.tracks(min_intervals)
    for number, track in enumerate(shown):
        places, faces = track.points.positions.tolist(), track.points.faces.tolist()
        for k, time in enumerate(track.times.tolist()):
            found = sequence.critical_points(int(np.searchsorted(sequence.middles, time)))
            at = int(np.flatnonzero(found.points.faces == faces[k])[0])
            derivatives = float(found.divergence[at]), float(found.curl[at])
            rows.append(
                [number, track.kinds[k], track.index, time, *places[k], faces[k], *derivatives]
            )
    write_csv(path, [_TRACKS, *rows])
    omitted = len(sequence.tracks(1)) - len(shown)
    if not omitted:
        return ""
    return (
        f"{Path(path).name} omits {counted(omitted, 'track')} of fewer than {min_intervals} "
        "intervals"
    )


def export_intervals(path: str | os.PathLike[str], sequence: Sequence) -> None:
    """Write a .csv with a line for each interval.

    The columns are:

    - ``interval``: number of the interval, from 0
    - ``start`` and ``end``: times of its frames
    - ``speed`` and ``uncertainty``: root mean squares over the surface
    - ``determined``: share of the squared speed that the frames determine, from 0 to 1
    - ``energy``: total energy of the field
    - ``residual`` and ``by_flow_lines``: residuals of the discrete flow and of flow lines
    - ``folded``: share of the faces that flow lines fold
    - ``verdict`` and ``reason``

    Unknown values are empty; an infinite uncertainty is ``inf``.
    """
    starts, ends = sequence.times[:-1], sequence.times[1:]
    numbers = [
        starts,
        ends,
        sequence.speed,
        sequence.speed_uncertainty,
        sequence.speed_determined,
        sequence.energies[:, 1, 0],
        sequence.residual,
        sequence.verified_residual,
        sequence.folded,
    ]
    pairs = zip(np.stack(numbers, axis=1).tolist(), sequence.verdicts, strict=True)
    rows = [
        [i, *("" if np.isnan(x) else x for x in row), verdict.kind, verdict.reason]
        for i, (row, verdict) in enumerate(pairs)
    ]
    write_csv(path, [_INTERVALS, *rows])

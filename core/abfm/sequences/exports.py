"""Sequences for other programs: ParaView, MNE, Connectome Workbench, and tables."""

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
    write_stc,
    write_values,
    write_whole,
)
from abfm.reading import read_collection
from abfm.sequences.sequence import Sequence
from abfm.types import FloatArray
from abfm.wording import counted
from abfm.workers.progress import stepped

_TRACKS = ["track", "kind", "index", "time", "x", "y", "z", "face", "divergence", "curl"]
_INTERVALS = [
    "interval",
    "start",
    "end",
    "speed",
    "uncertainty",
    "determined",
    "energy",
    "residual",
    "by_flow_lines",
    "folded",
    "verdict",
    "reason",
]


def vertex_speed(sequence: Sequence) -> FloatArray:
    """Return the speed at vertices in each interval, (T - 1, V): the mean of the faces around."""
    mean = averaging(sequence.mesh)
    return np.stack([mean @ np.linalg.norm(field, axis=1) for field in sequence.velocity])


def check_pvd(path: str | os.PathLike[str]) -> Path:
    """Refuse, before there is anything to write, a path that `export_pvd` would refuse, by a
    ResultError; else return the folder for its frames, where links lead.
    """
    path = Path(path)
    if path.suffix != ".pvd":
        raise ResultError(f"cannot write {path}: the name of a list of VTK's must end in .pvd")
    folder = Path(os.path.realpath(path.with_suffix("")))
    if folder.exists() and not folder.is_dir():
        raise ResultError(f"cannot make the folder {folder}: there is a file; choose another name")
    check_writable(path)
    if folder.is_dir():
        check_writable(folder / f"{path.stem}_0000.vtu")
    return folder


def export_pvd(path: str | os.PathLike[str], sequence: Sequence) -> None:
    """Write a film for ParaView: ``NAME.pvd``, and a ``NAME_0000.vtu`` a frame in a folder NAME.

    Point data are the ``frame``, the frame before ``carried`` to it, ``divergence`` and ``curl``,
    and where values are missing in some frame ``measured``, which is 0 where they are filled in;
    cell data the ``velocity``, its ``uncertainty`` (infinite where frames determine no motion) and
    how well it is ``determined``, from 0 to 1: fields of the interval that begins there, and at the
    last frame of that which ends there. Files replace older ones only when all are written: if
    that is cancelled or fails, the folder is as before. Frames
    that an older and longer one of that name lists are removed at the end.

    Raises
    ------
    ResultError
        If the name does not end in ``.pvd``, or a file cannot be written.
    """
    path, folder = Path(path), check_pvd(path)
    older = _own_frames(path)
    try:
        # where files can be moved from: a folder that is there may be on another disk
        with temporary_folder(folder if folder.is_dir() else folder.parent) as made:
            try:
                rows = _write_frames(made, path.stem, sequence)
            except ResultError as error:  # of the temporary folder, which the user never sees
                raise ResultError(str(error).replace(str(made), str(folder))) from error
            folder.mkdir(exist_ok=True)
            written = [each.name for each in sorted(made.iterdir())]
            for name in written:
                (made / name).replace(folder / name)
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
    write_whole(path, "".join(f"{line}\n" for line in lines))
    for name in older.difference(written):
        with suppress(OSError):
            (folder / name).unlink()


def _own_frames(path: Path) -> set[str]:
    """Return the files in its folder that a .pvd lists as this writes them; none where it is not
    there or cannot be read.
    """
    own = re.compile(f"{re.escape(path.stem)}/({re.escape(path.stem)}_[0-9]{{4,}}\\.vtu)")
    with suppress(OSError, ValueError):
        return {found[1] for _, name in read_collection(path) if (found := own.fullmatch(name))}
    return set()


def _write_frames(folder: Path, name: str, sequence: Sequence) -> list[str]:
    """Write a .vtu a frame into a folder; return the lines that list them in one of that name."""
    rows = []
    carried, unknown = sequence.frames[0], sequence.unknown
    measured = {} if unknown is None else {"measured": (~unknown).astype(np.uint8)}
    with stepped("writing frames", sequence.times.tolist()) as counted_times:
        for k, time in enumerate(counted_times):
            i = min(k, len(sequence) - 1)
            points = {
                **measured,
                "frame": _columns(sequence.frames[k]),
                "carried": _columns(carried),
                "divergence": sequence.divergence[i],
                "curl": sequence.curl[i],
            }
            file = f"{name}_{k:04}.vtu"
            cells = {
                name: getattr(sequence, name)[i]
                for name in ("velocity", "uncertainty", "determined")
            }
            export_vtu(folder / file, sequence.mesh, points, cells)
            rows.append(f'<DataSet timestep="{time!r}" file={quoteattr(f"{name}/{file}")}/>')
            if k < len(sequence):
                duration = float(sequence.times[k + 1]) - time
                carried = Flow(sequence.mesh, sequence.velocity[k], duration).push(
                    sequence.frames[k]
                )
    return rows


def _columns(frame: FloatArray) -> FloatArray:
    return frame if frame.shape[1] > 1 else frame[:, 0]


def export_stc(path: str | os.PathLike[str], sequence: Sequence) -> str:
    """Write the speed at all vertices for MNE, ``NAME-lh.stc`` or ``NAME-rh.stc``, a sample in the
    middle of each interval; the other file, the returned note and errors as of
    `abfm.io.write_stc`.
    """
    speed = vertex_speed(sequence)
    numbers, rows = sequence.mesh.numbered
    return write_stc(path, speed[:, rows], numbers, sequence.middles)


def export_speed(path: str | os.PathLike[str], sequence: Sequence) -> None:
    """Write the speed at the vertices of the mesh's file, a column for each interval, named by its
    middle: GIFTI, .npy, .csv or .mgh, see `abfm.io.write_values`. It is NaN where no face is.
    """
    speed = sequence.mesh.on_file(vertex_speed(sequence).T)
    names = [f"{time:.9g}" for time in sequence.middles]
    write_values(path, speed, sequence.mesh.structure, names, sequence.middles)


def export_tracks(path: str | os.PathLike[str], sequence: Sequence, min_intervals: int = 3) -> str:
    """Write a .csv of critical points, a line for each in each interval: its track, its kind, index
    and place there, the number of its face, and divergence and curl per unit of time.

    ``min_intervals`` is as in `Sequence.tracks`. Return a note with the number of shorter tracks.
    A ResultError reports why it cannot be written.
    """
    rows, kept = [], sequence.tracks(min_intervals)
    for number, track in enumerate(kept):
        places, faces = track.points.positions.tolist(), track.points.faces.tolist()
        for k, time in enumerate(track.times.tolist()):
            found = sequence.critical_points(int(np.searchsorted(sequence.middles, time)))
            at = int(np.flatnonzero(found.points.faces == faces[k])[0])
            turns = float(found.divergence[at]), float(found.curl[at])
            rows.append([number, track.kinds[k], track.index, time, *places[k], faces[k], *turns])
    write_csv(path, [_TRACKS, *rows])
    omitted = len(sequence.tracks(1)) - len(kept)
    if not omitted:
        return ""
    return (
        f"{Path(path).name} omits {counted(omitted, 'track')} of fewer than {min_intervals} "
        "intervals"
    )


def export_intervals(path: str | os.PathLike[str], sequence: Sequence) -> None:
    """Write a .csv with a line for each interval: its times, root mean squares of the speed and of
    its uncertainty over the surface, how well the frames determine it, from 0 to 1, the energy,
    mismatches by the discrete flow and by flow lines, the share of faces that these fold, and the
    verdict; cells of what is unknown are empty, and an infinite uncertainty is ``inf``.
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
    rows = [
        [i, *("" if np.isnan(x) else x for x in row), verdict.kind, verdict.reason]
        for i, (row, verdict) in enumerate(
            zip(np.stack(numbers, axis=1).tolist(), sequence.verdicts, strict=True)
        )
    ]
    write_csv(path, [_INTERVALS, *rows])

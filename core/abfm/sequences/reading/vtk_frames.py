"""Frames from VTK files: ParaView lists, or files with numbered names."""

import math
import os
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from abfm.errors import SeveralArraysError, brief, one_line
from abfm.functions.value_files import Request, one_array
from abfm.mesh import TriangleMesh
from abfm.reading import (
    ENDINGS,
    Format,
    Opened,
    counts_of,
    from_json,
    inflated_size_max,
    open_file,
    read_bytes,
    read_collection,
    referenced_file,
    vtk_contents,
)
from abfm.sequences.reading.frames_file import FramesFile
from abfm.types import FloatArray
from abfm.wording import counted
from abfm.workers.progress import stepped

_NUMBERED_NAME = re.compile(r"(.*?)([0-9]{1,18})(\.vt[kup])", re.IGNORECASE)
_KEYS = ("name", "time")  # keys of a file in a .series
# a larger distance of points from the vertices, relative to the mesh's size, is reported
_DISTANCE_MAX = 1e-3

_FRAMES_PER_FILE_MAX = 100  # mean over files; a malicious list may name one file very often

TimedFile = tuple[float, Path]


class Grid(NamedTuple):
    """Points (n, 3) of a VTK file, an array of point data (n, C), its name, and a time or NaN."""

    points: FloatArray
    values: FloatArray
    name: str
    time: float


def vtk_frames(opened: Opened, mesh: TriangleMesh, array: str | None) -> FramesFile:
    """Read frames from point data of a .pvd or .series list, or of numbered VTK files.

    ``array`` is the name of the point data, needed if there are several. OSError or ValueError if
    files are missing or invalid.
    """
    entries = _LISTS.get(opened.format, _numbered)(opened.path)
    if not entries:
        raise ValueError("it lists no files")
    is_list = opened.format in _LISTS
    for time, listed in entries if is_list else ():
        if not math.isfinite(time):
            name = brief(listed.name)
            raise ValueError(f"it lists {name} with the time {time:g}; expected a finite number")
    found = _of_grids(entries, mesh, array)
    if is_list:
        return found
    note = f"{counted(len(entries), 'file')} from {entries[0][1].name} to {entries[-1][1].name}"
    return found._replace(notes=(note, *found.notes))


def _collection(file: Path) -> list[TimedFile]:
    return [(time, referenced_file(file, name)) for time, name in read_collection(file)]


def _series(file: Path) -> list[TimedFile]:
    """Return the times and paths of the files in a .series file, ParaView's list in JSON."""
    content = from_json(read_bytes(file))
    files = content.get("files") if isinstance(content, dict) else None
    entries = []
    for entry in files if isinstance(files, list) else []:
        name, time = (entry.get(key) if isinstance(entry, dict) else None for key in _KEYS)
        if not isinstance(name, str) or not isinstance(time, int | float):
            raise ValueError(f"it lists {brief(entry)}; expected the name of a file and a time")
        try:
            entries.append((float(time), referenced_file(file, name)))
        except OverflowError:
            raise ValueError(f"it has the time {brief(time)}; expected a number") from None
    return entries


def _numbered(file: Path) -> list[TimedFile]:
    """Return all files whose names differ only in the number at the end; their times are NaN."""
    with_number = _NUMBERED_NAME.fullmatch(file.name)
    if with_number is None:
        raise ValueError(
            "it is a single frame without a number at the end of its name. Give one of several "
            "numbered files, such as wave_0001.vtu, or a .pvd"
        )
    read_bytes(file)  # raises an error about the given name
    found: dict[int, Path] = {}
    for other in sorted(file.parent.iterdir()):
        parts = _NUMBERED_NAME.fullmatch(other.name)
        if parts and (parts[1], parts[3]) == (with_number[1], with_number[3]):
            found.setdefault(int(parts[2]), other)
    return [(math.nan, found[number]) for number in sorted(found)]


_LISTS: dict[Format, Callable[[Path], list[TimedFile]]] = {
    Format.COLLECTION: _collection,
    Format.SERIES: _series,
}


def files_of_frames(path: str) -> list[str]:
    """Return the files of a VTK list, or the numbered files of which the path is one.

    The list is empty for files with another ending, and for files that cannot be read.
    """
    file = Path(os.path.expanduser(path))
    form = ENDINGS.get(file.suffix.lower())
    if form not in (*_LISTS, Format.VTK_XML, Format.VTK_LEGACY):
        return []
    with suppress(OSError, ValueError):  # reading the frames reports the error
        return list(dict.fromkeys(os.fspath(each) for _, each in _LISTS.get(form, _numbered)(file)))
    return []


def _of_grids(entries: Sequence[TimedFile], mesh: TriangleMesh, array: str | None) -> FramesFile:
    times = np.array([time for time, _ in entries])
    known = times[np.isfinite(times)]
    if len(np.unique(known)) < len(known):
        raise ValueError("two of its files have the same time; expected one file for each time")
    files = list(dict.fromkeys(file for _, file in entries))
    if len(entries) > _FRAMES_PER_FILE_MAX * len(files):
        raise ValueError(
            f"it lists {counted(len(entries), 'frame')} but only {counted(len(files), 'file')}; "
            "list each file once"
        )
    bytes_max = inflated_size_max(sum(_size(file) for file in files))
    found: dict[Path, Grid] = {}
    distance = 0.0
    with stepped("reading frames", files) as counted_files:
        for file in counted_files:
            found[file] = grid = _grid(file, mesh, array)
            shapes = [each.values.shape for each in (found[files[0]], grid)]
            if shapes[0] != shapes[1]:
                raise ValueError(
                    f"{brief(file.name)} has values of shape {shapes[1]}; the first file has "
                    f"{shapes[0]}"
                )
            if len(entries) * grid.values.nbytes > bytes_max:
                raise ValueError(
                    f"its {counted(len(entries), 'frame')} take more than {bytes_max} bytes, the "
                    "limit for files of this size"
                )
            is_complete = len(grid.points) == mesh.file_vertex_count
            points = grid.points[mesh.vertex_ids] if is_complete else grid.points
            distance = max(distance, float(np.abs(points - mesh.vertices).max()))
            found[file] = grid._replace(points=grid.points[:0])
    grids = [found[file] for _, file in entries]
    values = [each.values if each.values.shape[1] > 1 else each.values[:, 0] for each in grids]
    times = np.where(np.isfinite(times), times, [each.time for each in grids])
    notes = [] if array else [f"its frames are the point data {grids[0].name!r}"]
    if not distance <= _DISTANCE_MAX * mesh.length_scale:
        notes.append(
            f"points of the file are up to {distance:.3g} from the vertices of the mesh, whose "
            "positions are used"
        )
    order = np.argsort(times, kind="stable")
    is_ascending = (np.diff(times[order]) > 0).all()  # false, for example, if all times are 0
    if not (is_ascending and np.isfinite(times).all()):
        return FramesFile(np.stack(values), None, tuple(notes))
    return FramesFile(np.stack([values[k] for k in order]), times[order], tuple(notes))


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except (OSError, ValueError):  # reading the file reports the reason
        return 0


def _grid(file: Path, mesh: TriangleMesh, array: str | None) -> Grid:
    name, counts = brief(os.fspath(file.name)), counts_of(mesh)
    try:
        found = vtk_contents(open_file(file))
        if len(found.points) not in counts:
            count = len(found.points)
            raise ValueError(f"it has {counted(count, 'point')}; the mesh has {counts[1]} vertices")
        chosen = one_array(found.point_data, Request(counts, array))
    except OSError as error:
        raise ValueError(f"{name} cannot be read: {one_line(error)}") from error
    except SeveralArraysError as error:
        raise error.in_file(name) from error
    except ValueError as error:
        raise ValueError(f"{name}: {one_line(error, 300)}") from error
    return Grid(found.points, chosen.table(), chosen.names[0], found.time)

"""Reader of values at vertices from files of all formats, also of sequences, labels and maps."""

import math
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm import reading
from abfm.errors import FunctionError, SeveralArraysError, brief, did_you_mean, one_line
from abfm.functions.matlab_files import matlab_arrays
from abfm.functions.sides import warn_of_sides
from abfm.mesh import TriangleMesh
from abfm.mesh.readers.ply import ply_contents
from abfm.reading import LABEL, NODE_INDEX, SURFACE, Archive, Columns, Format, Keys, Opened
from abfm.reading.gifti import Gifti, GiftiArray
from abfm.types import FloatArray
from abfm.wording import counted
from abfm.workers.control import CancelledError

_KEY_MAX = 2**53  # largest key of labels, exact in double precision
_TIME_STEP_MAX = 20.0  # seconds between functional images; larger steps are milliseconds
_PART = re.compile(r"(.*)\[[0-9]{1,9}\]", re.DOTALL)
_MESH_COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha")
_VOLUMES = ("-vl.stc", "-vol.stc")
_NO_VALUES = {
    Format.HDF5: "Write MATLAB files with save(..., '-v7'), and other files as .npy",
    Format.COLLECTION: "Use one of the files that it lists",
    Format.SERIES: "Use one of the files that it lists",
}


class Request(NamedTuple):
    """The selection of values from a file that may have other values as well."""

    counts: tuple[int, ...] = ()  # numbers of vertices of the mesh and of its file
    array: str | None = None  # name of an array, for files with several
    hemisphere: str = ""  # "L" or "R" in files with both; empty for the hemisphere of the mesh
    integers: bool = False  # whether integers, such as vertex numbers, are expected
    mesh: TriangleMesh | None = None
    """Surface of the values, whose hemisphere is compared with that of the file."""


@contextmanager
def file_errors(path: str | os.PathLike[str], what: str = "file") -> Iterator[None]:
    """Convert all errors inside the context to a FunctionError that names the file."""
    name = f"{what} {brief(os.fspath(path))}"
    try:
        yield
    except CancelledError:
        raise
    except SeveralArraysError as error:
        raise error.in_file(name) from error
    except OSError as error:
        raise FunctionError(f"{name} cannot be read: {one_line(error)}") from error
    except Exception as error:  # a damaged file can cause any error in readers
        raise FunctionError(f"{name}: {one_line(error, 400)}") from error


def request_for(
    mesh: TriangleMesh | None, array: str | None = None, hemisphere: str = ""
) -> Request:
    if mesh is None:
        return Request(array=array, hemisphere=hemisphere)
    return Request(reading.counts_of(mesh), array, hemisphere, mesh=mesh)


def read_values(
    path: str | os.PathLike[str],
    mesh: TriangleMesh | None = None,
    column: str | None = None,
    hemisphere: str = "",
) -> Columns:
    """Read all columns of values from a file.

    These formats can be read:

    - .npy, .npz, .mat (not version 7.3): arrays
    - text (.csv, .tsv, .txt and similar): numbers separated by semicolons, tabs, commas or blanks
      with an optional line of names. Commas are decimal if there is another separator. Blank cells
      and NA become NaN.
    - GIFTI: a column for each array, without the arrays of a mesh
    - FreeSurfer: values, recognized by their first bytes
    - .mgh, .mgz, NIfTI images with a voxel for each vertex: a column for each frame
    - CIFTI: one hemisphere; its medial wall becomes NaN
    - VTK, PLY: data at the points of the mesh

    Parameters
    ----------
    path : path
    mesh : TriangleMesh, optional
        The mesh whose vertices get the values. Rows may have vertex numbers: node indices of GIFTI,
        or a column named vertex, node or index. Then vertices without a value get NaN. Otherwise
        the rows are the vertices of the mesh file. Without a mesh, the rows of the file are
        returned.
    column : str, optional
        Name of the array in .npz, .mat, VTK and PLY; ``NAME[1]`` is its second column.
    hemisphere : str
        Hemisphere, "L" or "R", in a file with both.

    Returns
    -------
    Columns
        Values (V, C), or (n, C) without a mesh.

    Raises
    ------
    FunctionError
        If the file cannot be read, has labels, or does not fit the mesh.
    """
    with file_errors(path):
        found = columns_of(
            reading.open_file(path), request_for(mesh, column, hemisphere)
        ).of_values()
        return found if mesh is None else found.on(mesh)


def read_column(
    path: str | os.PathLike[str],
    column: str | None = None,
    mesh: TriangleMesh | None = None,
    hemisphere: str = "",
) -> FloatArray:
    """Read one column of numbers, (V,), or (n,) without a mesh; see `read_values`.

    ``column`` is a name, or a number counted from 0. It is required if there are several columns.
    """
    found = read_values(path, mesh, column, hemisphere)
    with file_errors(path):
        return found.table()[:, found.number_of(column)]


def read_map_table(path: str | os.PathLike[str], domain: TriangleMesh) -> FloatArray:
    """Read a table (n, C) of vertex numbers, the images of the vertices of a mesh.

    Row i is the image of vertex i if the file has one value per vertex, or if its rows have vertex
    numbers. These are node indices of GIFTI, or a first column without a name, as pandas writes it.
    Otherwise rows are those of the file, such as pairs of vertices.
    """
    with file_errors(path, "map"):
        counts = reading.counts_of(domain)
        request = request_for(domain)._replace(integers=True)
        found = columns_of(reading.open_file(path), request).of_values()
        is_row = len(found.values) == 1 and found.values[0].size in counts
        has_index = found.names[:1] == ("",) and len(found.names) > 1
        is_placed = is_row or has_index or found.vertices is not None
        return (found.on(domain) if is_placed else found).table()


def columns_of(opened: Opened, request: Request) -> Columns:
    """Return the requested columns of an opened file, with the rows of the file.

    Raises ValueError if the file is invalid.
    """
    reader = READERS.get(opened.format)
    if reader is None:
        if opened.format is Format.UNKNOWN:
            endings = ", ".join((*reading.VALUES_ENDINGS, *reading.LABELS_ENDINGS))
            raise ValueError(
                f"the file is {opened.format}; expected {endings}, or a FreeSurfer file of values"
            )
        advice = _NO_VALUES.get(opened.format, "Use a file of values, such as lh.sulc")
        raise ValueError(f"the file is {opened.format}, not a table of numbers. {advice}")
    found = reader(opened, request)
    if request.hemisphere and request.hemisphere != found.structure:
        present = f"hemisphere {found.structure}" if found.structure else "one hemisphere"
        raise ValueError(f"the values are those of {present}. Omit hemisphere={request.hemisphere}")
    if request.mesh is not None:
        warn_of_sides(request.mesh, opened.path, found.structure)
    return found


def _text(opened: Opened, request: Request) -> Columns:
    names, table, places = reading.read_numbers(opened.data, request.integers)
    if not (names or request.integers):
        names, table = _numbered(table, request.counts)
    found = Columns(table, tuple(names), tuple(map(str, places)))
    if len(table) in request.counts and not request.integers and found.by_vertex() is found:
        _refuse_unsorted_vertices(table)
    return found


def _numbered(table: FloatArray, counts: tuple[int, ...]) -> tuple[list[str], FloatArray]:
    """Separate a first line of column names 0, 1, 2, ..., as pandas writes it, from a table.

    Return these names and the other rows, or no names and the table. ``counts`` are possible
    numbers of vertices.
    """
    count, width = table.shape
    is_clear = (count not in counts and count - 1 in counts) or (count > 1 and width in counts)
    if is_clear and width > 1 and np.array_equal(table[0], np.arange(width)):
        return [str(k) for k in range(width)], table[1:]
    return [], table


def _refuse_unsorted_vertices(table: FloatArray) -> None:
    """Raise a ValueError if the first column has each vertex number once, in another order."""
    first, count = table[:, 0], len(table)
    if table.shape[1] > 1 and (np.diff(first) != 1).any():
        for begin in (0, 1):
            if np.array_equal(np.sort(first), np.arange(begin, begin + count)):
                raise ValueError(
                    f"the first column has each number from {begin} to {begin + count - 1} once, "
                    "and may be vertex numbers. If so, name it vertex in the first line, and count "
                    "from 0"
                )


def _gifti(opened: Opened, request: Request) -> Columns:
    """Return the arrays of a GIFTI file as columns, without those of a mesh.

    Node indices, if there are any, number the rows.
    """
    gifti = reading.read_gifti(opened)
    is_mesh = any(array.intent in SURFACE for array in gifti.arrays)
    others = (*SURFACE, NODE_INDEX, *(["NIFTI_INTENT_VECTOR"] if is_mesh else []))  # normals
    arrays = {
        number: array._replace(values=_by_vertex(array.values, request.counts))
        for number, array in enumerate(gifti.arrays)
        if array.intent not in others
    }
    if not arrays:
        raise ValueError(
            "the file has a surface but no values; expected a file of values"
            if is_mesh
            else "the file has no data array; expected values at vertices"
        )
    if len({len(array.values) for array in arrays.values()}) > 1:
        sizes = " and ".join(dict.fromkeys(str(len(array.values)) for array in arrays.values()))
        raise ValueError(f"the arrays have {sizes} values; expected the same number in all")
    is_named = opened.path.name.lower().removesuffix(".gz").endswith(".label.gii")
    numbers, names, keys, columns = [], [], [], []
    for number, array in arrays.items():
        parts = array.values.reshape(len(array.values), -1).T
        is_labels = _is_labels(gifti, array, is_named)
        keys_of_array = Keys(gifti.names, gifti.colors) if is_labels else None
        for k, part in enumerate(parts):
            of_part = f"[{k}]" if len(parts) > 1 and len(arrays) > 1 else ""
            numbers.append(str(k) if len(arrays) == 1 < len(parts) else f"{number}{of_part}")
            names.append(f"{array.name}{of_part}" if array.name else "")
            keys.append(keys_of_array)
            columns.append(part)
    step, unit = gifti.time_step, "seconds"
    if step > _TIME_STEP_MAX:
        step, unit = step / 1000, "milliseconds"
    times = reading.even_times(step, len(columns))
    note = f"the TimeStep of {gifti.time_step:g} is interpreted as {unit}"
    return Columns(
        np.column_stack(columns),
        names=tuple(names) if any(names) else (),
        numbers=tuple(numbers),
        keys=tuple(keys) if any(keys) else (),
        vertices=_node_indices(gifti, len(columns[0])),
        structure=gifti.structure,
        times=times,
        notes=() if times is None else (note,),
    )


def _by_vertex(values: NDArray[Any], counts: tuple[int, ...]) -> NDArray[Any]:
    """Return an array with the axis of the vertices first, without axes of length 1."""
    flat = values.reshape([size for size in values.shape if size != 1] or 1)
    return np.moveaxis(flat, reading.vertex_axis(flat.shape, counts, 0), 0)


def _is_labels(gifti: Gifti, array: GiftiArray, is_named: bool) -> bool:
    """Return whether an array of a GIFTI file has labels.

    It has them by its intent, or by the name of the file (``is_named``). Without an intent,
    integers in a file with names of labels are labels. A name of the key 0 alone, which Workbench
    writes, is not enough.
    """
    is_integer = array.values.dtype.kind in "iub" or np.array_equal(
        array.values, np.rint(array.values)
    )
    if array.intent == LABEL or is_named:
        if not is_integer or (np.abs(array.values) > _KEY_MAX).any():
            raise ValueError("a label is not an integer; expected integer labels")
        return True
    has_names = any(name for key, name in gifti.names.items() if key != 0)
    return is_integer and has_names and array.intent in ("", "NIFTI_INTENT_NONE")


def _node_indices(gifti: Gifti, count: int) -> NDArray[np.int64] | None:
    indices = [array.values.reshape(-1) for array in gifti.arrays if array.intent == NODE_INDEX]
    if not indices:
        return None
    if any(not np.array_equal(each, indices[0]) for each in indices):
        raise ValueError(f"{len(indices)} arrays of node indices differ; expected one")
    if len(indices[0]) != count:
        raise ValueError(
            f"the file has {len(indices[0])} node indices for {count} values; expected "
            "equal numbers"
        )
    if indices[0].dtype.kind == "f" and not np.array_equal(indices[0], np.rint(indices[0])):
        raise ValueError("the node indices are not integers; expected numbers of vertices")
    return indices[0].astype(np.int64)


def _mgh(opened: Opened, request: Request) -> Columns:
    image, milliseconds = reading.freesurfer_frames(opened.data)
    return image_columns(image, request.counts, milliseconds / 1000)


def _nifti(opened: Opened, request: Request) -> Columns:
    image, seconds = reading.nifti_frames(opened.data)
    return image_columns(image, request.counts, seconds)


def image_columns(
    image: NDArray[Any], counts: tuple[int, ...], seconds: float = math.nan
) -> Columns:
    """Return the frames of an image with values at vertices as columns.

    The axes of the image are columns, rows, slices and frames. The voxels of a frame are the
    vertices, as written by FreeSurfer: (V, 1, 1), or other sizes with the product V. An image may
    also have only two axes, of vertices and of columns. Raises ValueError for an image of a volume.
    """
    table = image.reshape(-1, image.shape[3], order="F")
    if counts and len(table) not in counts:
        sizes = [size for size in image.shape if size > 1]
        if len(sizes) == 2 and {*sizes} & {*counts}:
            return Columns(image.reshape(sizes, order="F"))
        shown = " x ".join(map(str, image.shape[:3]))
        raise ValueError(
            f"the image has {shown} voxels, but the mesh has {counts[1]} vertices. Project a "
            "volume onto the surface first"
        )
    return Columns(table, times=reading.even_times(seconds, table.shape[1]))


def _stc(opened: Opened, request: Request) -> Columns:
    name = opened.path.name.lower()
    if name.endswith(_VOLUMES):
        raise ValueError(
            "by its name, the file belongs to a volume; expected a -lh.stc or -rh.stc of a surface"
        )
    side = {"-lh.stc": "L", "-rh.stc": "R"}.get(name[-7:], "")
    return replace(reading.read_stc(opened.data), structure=side)


def _annotation(opened: Opened, request: Request) -> Columns:
    labels = reading.freesurfer_annotation(opened.data)
    note = "the file has no names of labels; the keys are the colours of vertices, as numbers"
    keys = (Keys(labels.names, labels.colors),)
    return Columns(labels.values.reshape(-1, 1), keys=keys, notes=() if labels.names else (note,))


def _label_list(opened: Opened, request: Request) -> Columns:
    found = reading.freesurfer_label(opened.data)
    if len(found.values) == 0:
        raise ValueError("the file lists no vertices; expected at least one")
    return found


def _cifti(opened: Opened, request: Request) -> Columns:
    mesh_side = reading.side_of(request.mesh.structure) if request.mesh else None
    return reading.read_cifti(opened.data, request.counts, request.hemisphere, mesh_side or "")


def _npz(opened: Opened, request: Request) -> Columns:
    try:
        return _of_arrays(Archive(BytesIO(opened.data)), request)
    except (OSError, ValueError):  # SeveralArraysError is a ValueError
        raise
    except Exception as error:  # a damaged zip can cause any error in its reader
        reason = one_line(error, 300)
        raise ValueError(f"the file is not .npz, or is damaged or cut off ({reason})") from error


def _of_arrays(arrays: Mapping[str, NDArray[Any]], request: Request) -> Columns:
    """Return the requested or only suitable array of a file of named arrays.

    If another array is named vertex, node or index, it numbers the rows.
    """
    places = [each for each in arrays if reading.names_vertices(each)]
    if len(places) != 1 or len(arrays) == 1 or request.array == places[0]:
        return one_array(arrays, request)
    found, vertices = one_array(arrays, request, places), arrays[places[0]]
    if vertices.size not in found.values.shape:
        return found
    table = np.moveaxis(found.values, found.values.shape.index(vertices.size), 0)
    table = table.reshape(vertices.size, -1)
    name, count = found.numbers[0], table.shape[1]
    names = (places[0], *(f"{name}[{k}]" if count > 1 else name for k in range(count)))
    table = np.column_stack([vertices.reshape(-1), table])
    return replace(found, values=table, names=names, numbers=names)


def _vtk(opened: Opened, request: Request) -> Columns:
    return one_array(reading.vtk_contents(opened).point_data, request)


def one_array(
    arrays: Mapping[str, NDArray[Any]], request: Request, ignored: Collection[str] = ()
) -> Columns:
    """Return the requested array, or the only suitable one, of a file of named arrays.

    The arrays in ``ignored`` are returned only if they are requested.
    """
    name = _array_name(arrays, request, ignored)
    times = arrays["times"] if "times" in arrays and name != "times" else None
    if times is not None:
        if times.dtype.kind not in "iuf" or times.size != max(times.shape):
            expected = f"shape {times.shape}; expected real numbers (T,)"
            raise ValueError(f"the times have type {times.dtype} and {expected}")
        times = times.reshape(-1).astype(np.float64)
    numbers = (request.array or name,)
    return Columns(arrays[name], names=(name,), numbers=numbers, times=times, frames_first=True)


def _array_name(
    arrays: Mapping[str, NDArray[Any]], request: Request, ignored: Collection[str]
) -> str:
    names, word = sorted({*arrays} - {*ignored}), request.array
    if word is not None:
        part = _PART.fullmatch(word)
        name = word if word in arrays or not part else part[1]
        if name in arrays:
            return name
        problem = f"the file has no array {brief(name)}{did_you_mean(name, names)}"
    elif len(names) == 1 or "frames" in arrays:
        return "frames" if "frames" in arrays else names[0]
    else:
        kind = "result file without frames" if "format_version" in arrays else "file"
        problem = f"the {kind} has {counted(len(names), 'array')}"
    fitting = [each for each in names if _may_be_values(arrays, each, request.counts)]
    if word is None and len(fitting) == 1:
        return fitting[0]
    if not names:
        raise ValueError(
            "the file has no array of numbers at vertices. Structures, cells, sparse arrays and "
            "values of faces are not supported; save the values as a separate array"
        )
    listed = ", ".join(one_line(each, 30) for each in (fitting or names)[:8])
    text = f"{problem}: {listed}" if word is None else f"{problem}; its arrays are {listed}"
    if word is None and fitting and "format_version" not in arrays:
        raise SeveralArraysError(
            f"{text}. Choose one of them, as array=NAME (on the command line --array NAME)", fitting
        )
    raise ValueError(text)


def _may_be_values(arrays: Mapping[str, NDArray[Any]], name: str, counts: tuple[int, ...]) -> bool:
    try:
        values = arrays[name]
    except Exception:  # the array is damaged, or contains objects
        return False
    if values.ndim not in (1, 2, 3) or values.dtype.kind not in "biuf":
        return False
    return not counts or bool({*counts} & {*values.shape})


Reader = Callable[[Opened, Request], Columns]
READERS: dict[Format, Reader] = {
    Format.NPY: lambda opened, _: Columns(reading.array_from(opened.data), frames_first=True),
    Format.NPZ: _npz,
    Format.MAT: lambda opened, request: _of_arrays(matlab_arrays(opened.data), request),
    Format.VTK_XML: _vtk,
    Format.VTK_LEGACY: _vtk,
    Format.PLY: lambda opened, request: one_array(
        ply_contents(opened).columns, request, _MESH_COLUMNS
    ),
    Format.TABLE: _text,
    Format.GIFTI: _gifti,
    Format.CIFTI: _cifti,
    Format.FREESURFER_VALUES: lambda opened, _: Columns(reading.freesurfer_values(opened.data)),
    Format.FREESURFER_OLD_VALUES: lambda opened, _: Columns(reading.freesurfer_values(opened.data)),
    Format.FREESURFER_ASCII: lambda opened, _: reading.freesurfer_text(opened.data),
    Format.MGH: _mgh,
    Format.NIFTI: _nifti,
    Format.STC: _stc,
    Format.ANNOTATION: _annotation,
    Format.LABEL_LIST: _label_list,
}
"""The reader of values of each format."""
HAVE_NAMED_ARRAYS = (Format.NPZ, Format.MAT, Format.VTK_XML, Format.VTK_LEGACY, Format.PLY)
"""Formats whose arrays are chosen by name."""

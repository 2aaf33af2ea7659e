"""Values at vertices in NIfTI images and CIFTI-2 files, which are such images, read by nibabel.

Format: https://www.nitrc.org/projects/cifti. A file has one row of values for each grayordinate:
vertices of surfaces without the medial wall, and voxels. nibabel believes the sizes that a file
gives, so they are compared with the bytes of the file before an array is made.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.errors import one_line
from abfm.numerics.real_numbers import as_float64
from abfm.reading.columns import Columns, Keys, even_times
from abfm.reading.xml_trees import xml_tree
from abfm.types import FloatArray

_HEADER_BYTES = 540
_EXTENSION_CODE = 32
_SURFACE = "CIFTI_MODEL_TYPE_SURFACE"
_HEMISPHERES = {"CIFTI_STRUCTURE_CORTEX_LEFT": "L", "CIFTI_STRUCTURE_CORTEX_RIGHT": "R"}
_SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}
_MODELS = "CIFTI_INDEX_TYPE_BRAIN_MODELS"
_SERIES = "CIFTI_INDEX_TYPE_SERIES"
_OLD_VERSION = (
    "it is a file of CIFTI-1; expected CIFTI-2. Convert it: wb_command -file-convert "
    "-cifti-version-convert OLD 2 NEW"
)
_MAPS = ("CIFTI_INDEX_TYPE_SCALARS", "CIFTI_INDEX_TYPE_LABELS", _SERIES)


def read_cifti(
    data: bytes, counts: Collection[int], hemisphere: str = "", likely: str = ""
) -> Columns:
    """Read the columns of one hemisphere from .dscalar.nii, .dtseries.nii and .dlabel.nii.

    Parameters
    ----------
    data : bytes
    counts : collection of int
        How many vertices the surface may have, which chooses the hemisphere if only one fits.
    hemisphere : str
        "L" or "R", which must be in the file; empty if it is not known.
    likely : str
        The hemisphere of the surface, which is taken if it is there and nothing else is requested.

    Raises
    ------
    ValueError
        If the file is damaged, is of another type, or both hemispheres fit.
    """
    try:
        return _columns(data, counts, (hemisphere, likely))
    except (TypeError, AttributeError, LookupError) as error:  # what nibabel makes of damage
        raise ValueError("the XML in its header is damaged or incomplete") from error


def _columns(data: bytes, counts: Collection[int], sides: tuple[str, str]) -> Columns:
    head = _header(data)
    matrix = _matrix(data, head)
    kinds = [matrix.get_index_map(axis).indices_map_to_data_type for axis in range(2)]
    if _MODELS not in kinds or not set(kinds) & {*_MAPS}:
        shown = " and ".join(one_line(kind, 40).rpartition("TYPE_")[2].lower() for kind in kinds)
        raise ValueError(
            f"it is a CIFTI file of {shown}; expected values at vertices, as in .dscalar.nii, "
            ".dtseries.nii and .dlabel.nii"
        )
    axis = kinds.index(_MODELS)
    model, others = _model(matrix.get_index_map(axis), counts, sides)
    table = _table(data, head, axis)
    begin, count = int(model.index_offset), int(model.index_count)
    vertices = np.array(list(model.vertex_indices), dtype=np.int64)
    if not 0 <= begin <= begin + count <= len(table) or len(vertices) != count:
        raise ValueError(
            f"its hemisphere has {len(vertices)} vertices in rows {begin} to {begin + count} of "
            f"{len(table)}"
        )
    maps = matrix.get_index_map(1 - axis)
    named = list(maps.named_maps) if kinds[1 - axis] != _SERIES else []
    if named and len(named) != table.shape[1]:
        raise ValueError(f"it has names of {len(named)} maps for {table.shape[1]} columns")
    return Columns(
        _scaled(table[begin : begin + count], head),
        names=tuple((each.map_name or "").strip() for each in named),
        keys=tuple(map(_keys, named)) if kinds[1 - axis] == _MAPS[1] else (),
        vertices=vertices,
        vertex_count=int(model.surface_number_of_vertices),
        structure=_HEMISPHERES[model.brain_structure],
        times=None if named else _times(maps, table.shape[1]),
        notes=(f"other structures in it are ignored: {others}",) if others else (),
    )


def _header(data: bytes) -> Any:
    if len(data) < _HEADER_BYTES:
        raise ValueError(f"it is cut off: it has {len(data)} bytes of a header of {_HEADER_BYTES}")
    nifti: Any = import_module("nibabel.nifti2")  # takes time, and is typed in part
    return nifti.Nifti2Header(data[:_HEADER_BYTES], check=False)


def _matrix(data: bytes, head: Any) -> Any:
    """Return the description of rows and columns in the XML of the header."""
    begin = _HEADER_BYTES + 4
    while begin + 8 <= len(data):
        size, code = struct.unpack_from(f"{head.endianness}ii", data, begin)
        if size < 8 or begin + size > len(data):
            break
        if code == _EXTENSION_CODE:
            xml = data[begin + 8 : begin + size].rstrip(b"\0")
            xml_tree(xml)
            cifti: Any = import_module("nibabel.cifti2.parse_cifti2")
            parser = cifti.Cifti2Parser()
            try:
                parser.parse(string=xml)
            except Exception as error:  # whatever nibabel raises
                if str(getattr(parser.header, "version", "")).startswith("1"):
                    raise ValueError(_OLD_VERSION) from error
                raise ValueError("the XML in its header is damaged") from error
            return parser.header.matrix
        begin += size
    raise ValueError("it lacks the XML of a CIFTI-2 file, or is cut off")


def _model(models: Any, counts: Collection[int], sides: tuple[str, str]) -> tuple[Any, int]:
    """Return the brain model of one hemisphere, and how many others there are."""
    requested, likely = sides
    every = list(models.brain_models)
    found = [
        each
        for each in every
        if each.model_type == _SURFACE and each.brain_structure in _HEMISPHERES
    ]
    if not found:
        raise ValueError("it has no values on the surface of a hemisphere")
    known = "".join(_HEMISPHERES[each.brain_structure] for each in found)
    if len(set(known)) < len(known):
        raise ValueError("it has two models of one hemisphere")
    if requested and requested not in known:
        raise ValueError(f"it has no values of hemisphere {requested}, only of {known}")
    if (side := requested or likely) and side in known:
        return found[known.index(side)], len(every) - 1
    chosen = [each for each in found if each.surface_number_of_vertices in counts] or found
    if len(chosen) > 1:
        raise ValueError(
            "it holds both hemispheres, and that of the surface is not known: choose one by "
            "hemisphere=L or hemisphere=R, on the command line by --hemisphere"
        )
    return chosen[0], len(every) - 1


def _table(data: bytes, head: Any, axis: int) -> NDArray[Any]:
    """Return all numbers of the file, a row for each grayordinate."""
    shape = tuple(map(int, head.get_data_shape()))
    if len(shape) != 6 or shape[:4] != (1, 1, 1, 1):
        raise ValueError(f"it is an array of shape {shape}; expected two axes of numbers")
    numbers = _numbers(data, head, shape, shape[4:])
    return numbers if axis == 0 else numbers.T


def _numbers(
    data: bytes, head: Any, shape: tuple[int, ...], wanted: tuple[int, ...]
) -> NDArray[Any]:
    """Return the array after the header as the file has it, in a shape of the same size."""
    kind = head.get_data_dtype()
    begin, size = int(head["vox_offset"]), math.prod(shape) * kind.itemsize
    if min(shape) < 1 or kind.kind not in "biuf":
        raise ValueError(f"it is an array of {kind} of shape {shape}; expected real numbers")
    if begin < head.sizeof_hdr or begin + size > len(data):
        raise ValueError(
            f"it is cut off: {max(len(data) - begin, 0)} bytes are left for {size} of its values"
        )
    return np.frombuffer(data, kind, math.prod(shape), begin).reshape(wanted, order="F")


def _scaled(numbers: NDArray[Any], head: Any) -> FloatArray:
    """Return the values that stored numbers mean."""
    slope, intercept = float(head["scl_slope"]), float(head["scl_inter"])
    table = as_float64(numbers)
    if math.isfinite(slope) and slope and math.isfinite(intercept) and (slope, intercept) != (1, 0):
        table = table * slope + intercept
    return table


def nifti_frames(data: bytes) -> tuple[FloatArray, float]:
    """Return an image, (columns, rows, slices, frames), and the seconds between frames, or NaN.

    Errors as in `read_cifti`.
    """
    nifti: Any = import_module("nibabel.nifti2")
    heads = [int.from_bytes(data[:4], order) for order in ("little", "big")]  # bytes of the header
    kind = nifti.Nifti2Header if 540 in heads else nifti.Nifti1Header
    if len(data) < kind.sizeof_hdr:
        raise ValueError(
            f"it is cut off: it has {len(data)} bytes of a header of {kind.sizeof_hdr}"
        )
    head = kind(data[: kind.sizeof_hdr], check=False)
    shape = tuple(map(int, head.get_data_shape()))
    sizes = (*shape[:3], *[1] * (3 - len(shape)), math.prod(shape[3:]))
    image = _scaled(_numbers(data, head, shape or (0,), sizes), head)
    return image, frame_seconds(head)


def frame_seconds(head: Any) -> float:
    """Return the seconds between the frames of an image by its header of nibabel, or NaN."""
    steps = head.get_zooms()
    unit = head.get_xyzt_units()[1] if hasattr(head, "get_xyzt_units") else "msec"  # as in .mgh
    return _SECONDS.get(unit, math.nan) * float(steps[3]) if len(steps) > 3 else math.nan


def _keys(named: Any) -> Keys:
    """Return names and colours of the labels of a map."""
    names, colors = {}, {}
    for key, label in (named.label_table or {}).items():
        names[int(key)] = str(label.label or "").strip()
        red, green, blue, opacity = map(float, label.rgba)
        if all(0 <= part <= 1 for part in (red, green, blue, opacity)):
            colors[int(key)] = red, green, blue, opacity
    return Keys(names, colors)


def _times(series: Any, count: int) -> FloatArray | None:
    """Return seconds of the frames, or None if the file gives none."""
    if series.series_unit != "SECOND":
        return None
    scale = 10.0 ** (series.series_exponent or 0)
    begin, step = float(series.series_start or 0), float(series.series_step or 0)
    return even_times(scale * step, count, scale * begin)

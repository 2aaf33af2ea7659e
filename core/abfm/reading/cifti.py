"""Readers of values in CIFTI-2 files and NIfTI images, based on nibabel.

Format: https://www.nitrc.org/projects/cifti. A CIFTI-2 file is a NIfTI image with one row of values
for each grayordinate: vertices of surfaces without the medial wall, and voxels. The sizes in the
header, which nibabel does not check, are compared with the size of the file before an array is
created.
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
from abfm.wording import counted

_HEADER_BYTES = 540
_EXTENSION_CODE = 32
_SURFACE = "CIFTI_MODEL_TYPE_SURFACE"
_HEMISPHERES = {"CIFTI_STRUCTURE_CORTEX_LEFT": "L", "CIFTI_STRUCTURE_CORTEX_RIGHT": "R"}
_SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}
_MODELS = "CIFTI_INDEX_TYPE_BRAIN_MODELS"
_SERIES = "CIFTI_INDEX_TYPE_SERIES"
_OLD_VERSION = (
    "the file is CIFTI-1; expected CIFTI-2. Convert it with: wb_command -file-convert "
    "-cifti-version-convert OLD 2 NEW"
)
_MAPS = ("CIFTI_INDEX_TYPE_SCALARS", "CIFTI_INDEX_TYPE_LABELS", _SERIES)


def read_cifti(
    data: bytes, counts: Collection[int], hemisphere: str = "", likely: str = ""
) -> Columns:
    """Read the columns of one hemisphere from .dscalar.nii, .dtseries.nii and .dlabel.nii.

    ``hemisphere`` ("L" or "R") chooses the hemisphere, which must be in the file. If it is empty,
    ``likely``, the hemisphere of the surface, is read if the file has it. Otherwise the only
    hemisphere is read whose number of vertices is in ``counts``, the possible numbers for the
    surface. A file with one hemisphere needs no choice. Raises ValueError if the file is damaged or
    of another type, or if the choice is not unique.
    """
    try:
        return _columns(data, counts, (hemisphere, likely))
    except (TypeError, AttributeError, LookupError) as error:  # errors of nibabel for damaged files
        raise ValueError("the XML in the header is damaged or incomplete") from error


def _columns(data: bytes, counts: Collection[int], sides: tuple[str, str]) -> Columns:
    head = _header(data, import_module("nibabel.nifti2").Nifti2Header)
    matrix = _matrix(data, head)
    kinds = [matrix.get_index_map(axis).indices_map_to_data_type for axis in range(2)]
    if _MODELS not in kinds or not set(kinds) & {*_MAPS}:
        shown = " and ".join(one_line(kind, 40).rpartition("TYPE_")[2].lower() for kind in kinds)
        raise ValueError(
            f"the CIFTI file has {shown}; expected values at vertices, as in .dscalar.nii, "
            ".dtseries.nii and .dlabel.nii"
        )
    axis = kinds.index(_MODELS)
    model, others = _model(matrix.get_index_map(axis), counts, sides)
    table = _table(data, head, axis)
    begin, count = int(model.index_offset), int(model.index_count)
    vertices = np.array(list(model.vertex_indices), dtype=np.int64)
    if not 0 <= begin <= begin + count <= len(table) or len(vertices) != count:
        raise ValueError(
            f"the hemisphere has {len(vertices)} vertices, but rows {begin} to {begin + count} of "
            f"{len(table)}; the file may be damaged"
        )
    maps = matrix.get_index_map(1 - axis)
    named = list(maps.named_maps) if kinds[1 - axis] != _SERIES else []
    if named and len(named) != table.shape[1]:
        raise ValueError(
            f"the file has names of {counted(len(named), 'map')} for "
            f"{counted(table.shape[1], 'column')}; expected equal numbers"
        )
    return Columns(
        _scaled(table[begin : begin + count], head),
        names=tuple((each.map_name or "").strip() for each in named),
        keys=tuple(map(_keys, named)) if kinds[1 - axis] == _MAPS[1] else (),
        vertices=vertices,
        vertex_count=int(model.surface_number_of_vertices),
        structure=_HEMISPHERES[model.brain_structure],
        times=None if named else _times(maps, table.shape[1]),
        notes=(f"other structures in the file are ignored: {others}",) if others else (),
    )


def _header(data: bytes, kind: Any) -> Any:
    size = kind.sizeof_hdr
    if len(data) < size:
        raise ValueError(
            f"the file is cut off: it has {len(data)} bytes, but its header alone has {size}"
        )
    return kind(data[:size], check=False)


def _matrix(data: bytes, head: Any) -> Any:
    """Return the matrix element of the XML in the header, which describes rows and columns."""
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
            except Exception as error:  # nibabel raises errors of many types
                if str(getattr(parser.header, "version", "")).startswith("1"):
                    raise ValueError(_OLD_VERSION) from error
                raise ValueError("the XML in the header is damaged") from error
            return parser.header.matrix
        begin += size
    raise ValueError("the file has no XML of CIFTI-2, or is cut off")


def _model(models: Any, counts: Collection[int], sides: tuple[str, str]) -> tuple[Any, int]:
    """Return the brain model of the hemisphere that is read, and the number of other models.

    A brain model describes the vertices of one structure. ``sides`` are the parameters
    ``hemisphere`` and ``likely`` of `read_cifti`.
    """
    requested, likely = sides
    every = list(models.brain_models)
    found = [
        each
        for each in every
        if each.model_type == _SURFACE and each.brain_structure in _HEMISPHERES
    ]
    if not found:
        raise ValueError("the file has no values on the surface of a hemisphere")
    present = "".join(_HEMISPHERES[each.brain_structure] for each in found)
    if len(set(present)) < len(present):
        raise ValueError(
            f"the file has several brain models of a hemisphere ({present}); expected one for each"
        )
    if requested and requested not in present:
        raise ValueError(f"the file has no values of hemisphere {requested}, only of {present}")
    if (side := requested or likely) and side in present:
        return found[present.index(side)], len(every) - 1
    chosen = [each for each in found if each.surface_number_of_vertices in counts] or found
    if len(chosen) > 1:
        raise ValueError(
            "the file has both hemispheres, and the hemisphere of the surface is unknown. Choose "
            "hemisphere=L or hemisphere=R (on the command line: --hemisphere)"
        )
    return chosen[0], len(every) - 1


def _table(data: bytes, head: Any, axis: int) -> NDArray[Any]:
    """Return all numbers, with a row for each grayordinate (``axis`` 0 or 1 in the file)."""
    shape = tuple(map(int, head.get_data_shape()))
    if len(shape) != 6 or shape[:4] != (1, 1, 1, 1):
        raise ValueError(f"the array of the file has shape {shape}; expected two axes of numbers")
    numbers = _numbers(data, head, shape, shape[4:])
    return numbers if axis == 0 else numbers.T


def _numbers(
    data: bytes, head: Any, shape: tuple[int, ...], new_shape: tuple[int, ...]
) -> NDArray[Any]:
    """Return the array after the header as ``new_shape``, without the scaling in the header."""
    kind = head.get_data_dtype()
    begin, size = int(head["vox_offset"]), math.prod(shape) * kind.itemsize
    if min(shape) < 1 or kind.kind not in "biuf":
        raise ValueError(
            f"the array of the file has type {kind} and shape {shape}; expected real numbers"
        )
    if begin < head.sizeof_hdr or begin + size > len(data):
        raise ValueError(
            f"the file is cut off: its values have {size} bytes, but only "
            f"{max(len(data) - begin, 0)} follow the header"
        )
    return np.frombuffer(data, kind, math.prod(shape), begin).reshape(new_shape, order="F")


def _scaled(numbers: NDArray[Any], head: Any) -> FloatArray:
    slope, intercept = float(head["scl_slope"]), float(head["scl_inter"])
    table = as_float64(numbers)
    if math.isfinite(slope) and slope and math.isfinite(intercept) and (slope, intercept) != (1, 0):
        table = table * slope + intercept
    return table


def nifti_frames(data: bytes) -> tuple[FloatArray, float]:
    """Return an image (columns, rows, slices, frames) and the seconds between frames, or NaN.

    Errors are those of `read_cifti`.
    """
    nifti: Any = import_module("nibabel.nifti2")  # the import is slow, and types are incomplete
    heads = [int.from_bytes(data[:4], order) for order in ("little", "big")]  # size of the header
    head = _header(data, nifti.Nifti2Header if 540 in heads else nifti.Nifti1Header)
    shape = tuple(map(int, head.get_data_shape()))
    sizes = (*shape[:3], *[1] * (3 - len(shape)), math.prod(shape[3:]))
    image = _scaled(_numbers(data, head, shape or (0,), sizes), head)
    return image, frame_seconds(head)


def frame_seconds(head: Any) -> float:
    """Return the seconds between frames in a nibabel header, or NaN if it has no time."""
    steps = head.get_zooms()
    unit = head.get_xyzt_units()[1] if hasattr(head, "get_xyzt_units") else "msec"  # .mgh
    return _SECONDS.get(unit, math.nan) * float(steps[3]) if len(steps) > 3 else math.nan


def _keys(named: Any) -> Keys:
    names, colors = {}, {}
    for key, label in (named.label_table or {}).items():
        names[int(key)] = str(label.label or "").strip()
        red, green, blue, opacity = map(float, label.rgba)
        if all(0 <= part <= 1 for part in (red, green, blue, opacity)):
            colors[int(key)] = red, green, blue, opacity
    return Keys(names, colors)


def _times(series: Any, count: int) -> FloatArray | None:
    """Return the times of ``count`` frames in seconds; None if the axis of frames is not time."""
    if series.series_unit != "SECOND":
        return None
    scale = 10.0 ** (series.series_exponent or 0)
    begin, step = float(series.series_start or 0), float(series.series_step or 0)
    return even_times(scale * step, count, scale * begin)

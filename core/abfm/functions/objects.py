"""Values at vertices from objects of other libraries, recognized by their attributes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from abfm.calculus.channels import at_vertices, with_checked_shape
from abfm.errors import AbfmError, FunctionError, one_line
from abfm.functions.family import texts_of
from abfm.functions.files import ValuesFile
from abfm.functions.sources import interpolate_sources
from abfm.functions.spec import function
from abfm.functions.value_files import columns_of, image_columns, request_for
from abfm.mesh import TriangleMesh
from abfm.mesh.objects import has, part_of
from abfm.reading import Columns, Format, Opened, counts_of, frame_seconds, side_of
from abfm.types import FloatArray
from abfm.workers.control import CancelledError

_CHOOSE = 'Choose a hemisphere: abfm.load_mesh(..., hemisphere="L") or "R"'


class ObjectValues(NamedTuple):
    """Values from an image or a source estimate; rows are its vertices or its sources."""

    columns: Columns
    are_sources: bool = False


def as_values(
    mesh: TriangleMesh, source: Any, name: str = "values", error: type[AbfmError] = FunctionError
) -> FloatArray:
    """Return values at the vertices of a mesh or of its file, (V,) or (V, C).

    Parameters
    ----------
    mesh : TriangleMesh
    source : array or object
        Values in one of the following forms. If there are two hemispheres, that of the mesh is
        chosen.

        - anything that NumPy converts to an array, also of PyTorch or PyVista; masked values are
          NaN
        - a Series or DataFrame of pandas or Polars, or an array of xarray, see `at_vertices`
        - a nibabel image (GIFTI, CIFTI, MGH), or nilearn's ``SurfaceImage`` or ``PolyData``
        - MNE's ``SourceEstimate``, which is interpolated between its sources
        - the ``Path`` of a file of values
        - a function as text
    name : str
        Name of the values in messages.

    Raises
    ------
    AbfmError
        An ``error`` if the values are not real numbers, are labels, or do not fit the mesh.
    """
    if isinstance(source, str):
        return function(mesh, source, allow_missing=True)
    if isinstance(source, os.PathLike):
        return ValuesFile(path=os.fspath(source)).evaluate(mesh)
    try:
        found = values_of_object(mesh, source)
        if found is None:
            return with_checked_shape(mesh, at_vertices(mesh, source, name, error), name, error)
        if found.are_sources:
            table = interpolate_sources(found.columns, mesh)[0].T
        else:
            table = found.columns.of_values().on(mesh).table()
    except (CancelledError, MemoryError, AbfmError):
        raise
    except Exception as problem:  # objects of other libraries may raise any error
        raise error(f"{name}: {one_line(problem, 400)}") from problem
    return table[:, 0] if table.shape[1] == 1 else table


def texts_or_values(mesh: TriangleMesh, source: Any, name: str) -> Any:
    """Return texts and None unchanged, and convert anything else by `as_values`."""
    return source if source is None or texts_of(source) else as_values(mesh, source, name)


def values_of_object(mesh: TriangleMesh, source: Any) -> ObjectValues | None:
    """Return the values of an image or a source estimate; None for any other object.

    Raises ValueError if the object has no values of one surface.
    """
    side = side_of(mesh.structure) or ""
    if has(source, "vertices", "data", "tmin", "tstep"):
        return ObjectValues(_of_sources(source, side), are_sources=True)
    if has(source, "mesh", "data") and has(source.data, "parts"):  # a SurfaceImage of nilearn
        source = source.data
    if has(source, "parts"):  # a PolyData of nilearn
        return ObjectValues(Columns(np.asarray(_part(source.parts, side))))
    if has(source, "to_bytes", "darrays"):  # GIFTI, also with types outside of the standard
        opened = Opened(Path("the image"), Format.GIFTI, source.to_bytes(mode="force"))
        return ObjectValues(columns_of(opened, request_for(mesh)))
    if has(source, "to_bytes", "nifti_header"):  # a CIFTI image of nibabel
        opened = Opened(Path("the image"), Format.CIFTI, source.to_bytes())
        return ObjectValues(columns_of(opened, request_for(mesh, None, side)))
    if has(source, "dataobj", "affine"):
        image = np.asarray(source.dataobj)
        sizes = (*image.shape[:3], *[1] * (3 - image.ndim), -1)
        image = image.reshape(sizes, order="F")
        return ObjectValues(image_columns(image, counts_of(mesh), frame_seconds(source.header)))
    return None


def _part(parts: Mapping[str, Any], side: str) -> Any:
    if not side and len(parts) > 1:
        raise ValueError(f"the object has two hemispheres. {_CHOOSE}")
    return part_of(parts, side)


def _of_sources(estimate: Any, side: str) -> Columns:
    vertices = [np.asarray(each, dtype=np.int64) for each in estimate.vertices]
    values = np.asarray(estimate.data)
    if len(vertices) != 2 or values.ndim != 2:
        raise ValueError(
            f"the source estimate has shape {values.shape}; expected one value for each source "
            "of a surface and each time, as in the result of magnitude()"
        )
    present = [k for k in range(2) if len(vertices[k])]
    if not side and len(present) > 1:
        raise ValueError(f"the object has two hemispheres. {_CHOOSE}")
    chosen = "LR".index(side) if side else present[0] if present else 0
    if chosen not in present:
        raise ValueError(
            f"the source estimate has no source in hemisphere {'LR'[chosen]}, the "
            "hemisphere of the mesh"
        )
    first, times = chosen * len(vertices[0]), np.asarray(estimate.times, dtype=np.float64)
    values = values[first : first + len(vertices[chosen])]
    return Columns(values, vertices=vertices[chosen], times=times)

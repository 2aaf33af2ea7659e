"""Values of other libraries at vertices, recognised by their attributes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from abfm.calculus.channels import at_vertices
from abfm.errors import AbfmError, FunctionError, one_line
from abfm.functions.family import texts_of
from abfm.functions.files import ValuesFile
from abfm.functions.sources import between_sources
from abfm.functions.spec import function
from abfm.functions.value_files import columns_of, image_columns, request_for
from abfm.mesh import TriangleMesh
from abfm.mesh.objects import has, part_of
from abfm.reading import Columns, Format, Opened, counts_of, frame_seconds, side_of
from abfm.types import FloatArray
from abfm.workers.control import CancelledError

_CHOOSE = 'choose one of both hemispheres: abfm.load_mesh(..., hemisphere="L") or "R"'


class ObjectValues(NamedTuple):
    """The columns of an image or a source estimate, and whether they are those of sources."""

    columns: Columns
    are_sources: bool = False


def as_values(
    mesh: TriangleMesh, given: Any, name: str = "values", error: type[AbfmError] = FunctionError
) -> FloatArray:
    """Return values at the vertices of a mesh or of its file, (V,) or (V, C).

    Parameters
    ----------
    mesh : TriangleMesh
    given : array or object
        Anything that NumPy makes an array of, also masked (then NaN), of PyTorch or PyVista; a
        Series or DataFrame of pandas or Polars, or an array of xarray, see `at_vertices`; a nibabel
        image (GIFTI, CIFTI, MGH) or nilearn's ``SurfaceImage`` or ``PolyData``; MNE's
        ``SourceEstimate``, interpolated between its sources; the ``Path`` of a file of values; or a
        function as text. Of both hemispheres the mesh's own one is taken.
    name : str
        What messages call them.

    Raises
    ------
    AbfmError
        An ``error`` if they are no real numbers, hold labels, or do not fit the mesh.
    """
    if isinstance(given, str):
        return function(mesh, given, may_be_unknown=True)
    if isinstance(given, os.PathLike):
        return ValuesFile(path=os.fspath(given)).evaluate(mesh)
    try:
        found = values_of_object(mesh, given)
        if found is None:
            return at_vertices(mesh, given, name, error)
        if found.are_sources:
            table = between_sources(found.columns, mesh)[0].T
        else:
            table = found.columns.of_values().on(mesh).table()
    except (CancelledError, MemoryError, AbfmError):
        raise
    except Exception as problem:  # the objects are not ours, and may raise anything
        raise error(f"{name}: {one_line(problem, 400)}") from problem
    return table[:, 0] if table.shape[1] == 1 else table


def texts_or_values(mesh: TriangleMesh, given: Any, name: str) -> Any:
    """Return functions given as text, or None, as they are, and anything else by `as_values`."""
    return given if given is None or texts_of(given) else as_values(mesh, given, name)


def values_of_object(mesh: TriangleMesh, given: Any) -> ObjectValues | None:
    """Return the values of an image or a source estimate; None for anything else.

    Raises
    ------
    ValueError
        If it holds no values of one surface.
    """
    side = side_of(mesh.structure) or ""
    if has(given, "vertices", "data", "tmin", "tstep"):
        return ObjectValues(_of_sources(given, side), are_sources=True)
    if has(given, "mesh", "data") and has(given.data, "parts"):  # SurfaceImage
        given = given.data
    if has(given, "parts"):  # PolyData
        return ObjectValues(Columns(np.asarray(_part(given.parts, side))))
    if has(given, "to_bytes", "darrays"):  # GIFTI; of other types than those of its standard, too
        opened = Opened(Path("the image"), Format.GIFTI, given.to_bytes(mode="force"))
        return ObjectValues(columns_of(opened, request_for(mesh)))
    if has(given, "to_bytes", "nifti_header"):  # CIFTI
        opened = Opened(Path("the image"), Format.CIFTI, given.to_bytes())
        return ObjectValues(columns_of(opened, request_for(mesh, None, side)))
    if has(given, "dataobj", "affine"):
        image = np.asarray(given.dataobj)
        sizes = (*image.shape[:3], *[1] * (3 - image.ndim), -1)
        image = image.reshape(sizes, order="F")
        return ObjectValues(image_columns(image, counts_of(mesh), frame_seconds(given.header)))
    return None


def _part(parts: Mapping[str, Any], side: str) -> Any:
    if not side and len(parts) > 1:
        raise ValueError(f"it has two parts; {_CHOOSE}")
    return part_of(parts, side)


def _of_sources(estimate: Any, side: str) -> Columns:
    vertices = [np.asarray(each, dtype=np.int64) for each in estimate.vertices]
    values = np.asarray(estimate.data)
    if len(vertices) != 2 or values.ndim != 2:
        raise ValueError(
            f"it is a source estimate of shape {values.shape}; expected one of a surface, with a "
            "value for each source and time, such as its magnitude()"
        )
    known = [k for k in range(2) if len(vertices[k])]
    if not side and len(known) > 1:
        raise ValueError(_CHOOSE)
    chosen = "LR".index(side) if side else known[0] if known else 0
    if chosen not in known:
        raise ValueError(f"it has no source in hemisphere {'LR'[chosen]}, which the mesh is of")
    first = chosen * len(vertices[0])
    return Columns(
        values[first : first + len(vertices[chosen])],
        vertices=vertices[chosen],
        times=np.asarray(estimate.times, dtype=np.float64),
    )

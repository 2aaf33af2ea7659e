"""Conversion from and to surface images of nilearn (meshes and values of hemispheres).

nilearn (``pip install 'abfm[brain]'``) is only required for the conversion to a surface image.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AbfmError, ResultError, brief, one_line
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import HEMISPHERES
from abfm.types import FloatArray


def from_surface_image(image: Any) -> dict[str, tuple[TriangleMesh, FloatArray]]:
    """Return the mesh of each part of nilearn's ``SurfaceImage``, and its values (V,) or (V, T).

    Parts are named ``left`` and ``right``. Vertices that no face uses are dropped, with their
    values.

    Raises
    ------
    ResultError
        If it is not such an image, or its values are not real numbers.
    MeshError
        If a part has a mesh that the solver cannot use.
    """
    try:
        meshes, values = dict(image.mesh.parts), dict(image.data.parts)
        arrays = {part: (mesh.coordinates, mesh.faces) for part, mesh in meshes.items()}
    except (AttributeError, TypeError, ValueError):
        raise ResultError(
            f"the image is {brief(type(image).__name__)}; expected nilearn's SurfaceImage"
        ) from None
    found = {}
    for part, (vertices, faces) in arrays.items():
        if part not in values:
            raise ResultError(f"the part {brief(part)} of the image has a mesh but no values")
        try:
            mesh = TriangleMesh(vertices, faces)
            numbers = real_numbers(values[part], "its values", ResultError)
            found[part] = mesh, mesh.restrict(numbers)
        except AbfmError as error:
            raise type(error)(f"part {brief(part)} of the image: {one_line(error)}") from error
    return found


def to_surface_image(parts: Mapping[str, tuple[TriangleMesh, ArrayLike]]) -> Any:
    """Return nilearn's ``SurfaceImage`` of meshes and their values, shape (V,) or (V, T).

    Parameters
    ----------
    parts : mapping
        Mesh and values of ``left``, ``right`` or both, with the same T.

    Raises
    ------
    ResultError
        If nilearn is missing, a part has another name, or values do not fit their mesh or the other
        part.
    """
    if not parts or not set(parts) <= {*HEMISPHERES.values()}:
        raise ResultError(
            f"the parts of a surface image are {brief(list(parts))}; expected left, right or both"
        )
    arrays = {}
    for part, (mesh, array) in parts.items():
        values = real_numbers(array, f"values of the part {part}", ResultError)
        if values.ndim not in (1, 2) or len(values) != len(mesh.vertices):
            count = len(mesh.vertices)
            raise ResultError(
                f"values of the part {part} have shape {values.shape}; expected ({count},) or "
                f"({count}, T)"
            )
        arrays[part] = np.array(values)
    if len({values.shape[1:] for values in arrays.values()}) > 1:
        shapes = " and ".join(str(values.shape) for values in arrays.values())
        raise ResultError(
            f"values of the parts have shapes {shapes}; expected the same number of columns"
        )
    try:
        surface = import_module("nilearn.surface")
    except ImportError:
        raise ResultError(
            "nilearn is not installed. Install it with: pip install 'abfm[brain]'"
        ) from None
    meshes = {
        part: surface.InMemoryMesh(np.array(mesh.vertices), np.array(mesh.faces))
        for part, (mesh, _) in parts.items()
    }
    return surface.SurfaceImage(surface.PolyMesh(**meshes), surface.PolyData(**arrays))

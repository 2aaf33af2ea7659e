"""What the screen can show: graphics cards compute with seven digits, and squares must not overflow."""

from __future__ import annotations

import numpy as np

from abfm import FunctionError, MeshError, TriangleMesh
from abfm.mesh import FloatArray

_LEAST_VALUE, _LARGEST_VALUE = 1e-30, 1e30
_LEAST_LENGTH, _LARGEST_LENGTH = 1e-12, 1e12
_FARTHEST = 1e5  # from the origin, in sizes of the mesh: rounding is visible beyond


def check_mesh(mesh: TriangleMesh) -> None:
    """Refuse a mesh that cannot be drawn.

    Raises
    ------
    MeshError
        If it is too small, too large, or too far from the origin for its size.
    """
    size, farthest = mesh.length_scale, float(np.abs(mesh.vertices).max())
    if not _LEAST_LENGTH <= size <= _LARGEST_LENGTH:
        raise MeshError(
            f"the mesh measures {size:.3g} (the root of its area); meshes of {_LEAST_LENGTH:g} to {_LARGEST_LENGTH:g} "
            "can be drawn: scale its coordinates"
        )
    if farthest > _FARTHEST * size:
        raise MeshError(
            f"the mesh measures {size:.3g} and has coordinates up to {farthest:.3g}, too far from the origin to be "
            "drawn: subtract its centre from its coordinates"
        )


def check_function(name: str, values: FloatArray) -> None:
    """Refuse a function (V,) that cannot be shown.

    Raises
    ------
    FunctionError
        If its largest value is too large, or too small and not 0.
    """
    largest = float(np.abs(values).max())
    if largest > _LARGEST_VALUE or 0 < largest < _LEAST_VALUE:
        raise FunctionError(
            f"{name} has values up to {largest:.3g}; {_LEAST_VALUE:g} to {_LARGEST_VALUE:g} can be shown: scale it"
        )

"""Functions with missing values at some vertices."""

from __future__ import annotations

from typing import Any

import numpy as np

from abfm.calculus.channels import extend_all
from abfm.errors import FunctionError
from abfm.functions.family import texts_of
from abfm.functions.objects import as_values
from abfm.functions.spec import function
from abfm.mesh import TriangleMesh
from abfm.types import BoolArray, FloatArray


def known_functions(
    mesh: TriangleMesh, functions: Any, name: str, mask: FloatArray | None = None
) -> tuple[FloatArray, BoolArray]:
    """Return functions (C, V) and a mask (V,) of the vertices with values in all channels.

    At other vertices, the functions are 0. ``functions`` are values (V,) or (V, C) or texts. Values
    are missing if they are not finite, or where ``mask`` (V,) is 0. Messages use ``name``. Raises a
    FunctionError if the shape does not fit, or if no vertex has values in all channels.
    """
    if texts := texts_of(functions):
        values = np.stack([function(mesh, text, allow_missing=True) for text in texts])
    else:
        array = as_values(mesh, functions, name)
        values = mesh.restrict(array.reshape(len(array), -1)).T
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=0))
    if mask is not None:
        known &= mask > 0
    if not known.any():
        raise FunctionError(
            f"no vertex has finite values in all channels of {name}. Use other functions, or masks "
            "with more vertices"
        )
    return np.where(known, values, 0), known


def filled(mesh: TriangleMesh, functions: FloatArray, known: BoolArray) -> FloatArray:
    """Fill in functions (C, V) where ``known`` (V,) is False, from known values around.

    They are returned unchanged if nothing is known.
    """
    return extend_all(mesh, functions, known) if known.any() else functions

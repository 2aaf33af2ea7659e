"""Functions that are not known everywhere."""

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
    mesh: TriangleMesh, given: Any, name: str, mask: FloatArray | None = None
) -> tuple[FloatArray, BoolArray]:
    """Return functions (C, V), 0 where one of them is unknown, and where all are known, (V,).

    Parameters
    ----------
    given : (V,) or (V, C) array, str or sequence of str
        Values, or functions as texts; they are unknown where they are not finite.
    name : str
        What messages call them.
    mask : (V,) array, optional
        They are also unknown where it is 0.

    Raises
    ------
    FunctionError
        If their shape does not fit, or they are known nowhere.
    """
    if texts := texts_of(given):
        values = np.stack([function(mesh, text, may_be_unknown=True) for text in texts])
    else:
        array = as_values(mesh, given, name)
        if array.ndim not in (1, 2) or array.size == 0:
            raise FunctionError(f"{name} has shape {array.shape}; expected (V,) or (V, C)")
        values = mesh.restrict(array.reshape(len(array), -1)).T
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=0))
    if mask is not None:
        known &= mask > 0
    if not known.any():
        raise FunctionError(
            f"no vertex has finite values in all channels of {name}; give others, or masks "
            "that leave more vertices"
        )
    return np.where(known, values, 0), known


def filled(mesh: TriangleMesh, functions: FloatArray, known: BoolArray) -> FloatArray:
    """Return functions (C, V) filled in from around where they are not known, (V,); as they are if
    they are known nowhere.
    """
    return extend_all(mesh, functions, known) if known.any() else functions

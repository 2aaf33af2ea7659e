"""Type aliases of arrays and files."""

import os
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
IndexArray: TypeAlias = NDArray[Any]
"""Integers of any size, as in sparse matrices and compiled kernels."""
File: TypeAlias = str | os.PathLike[str] | BinaryIO  # a path, or an open binary file

"""Arrays by their entries, and files."""

import os
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
IndexArray: TypeAlias = NDArray[Any]
"""Whole numbers of any size, as sparse matrices and kernels have them."""
File: TypeAlias = str | os.PathLike[str] | BinaryIO
"""A path, or a file that is open."""

"""Arrays in NumPy's own format (.npy): a header is believed when it fits what follows it, byte for
byte.

NumPy reads the header, whatever it throws at damaged ones; not the array, for which it would make
room before it looks whether so much follows.
"""

import io
import math
import sys
import warnings
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from abfm.errors import one_line

_READERS = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
    (3, 0): npy.read_array_header_2_0,  # whose letters beyond ASCII are in names of fields
}


def array_from(data: bytes) -> NDArray[Any]:
    """Return the array of numbers, booleans or texts that the bytes of a .npy file hold.

    Raises
    ------
    ValueError
        If they are no .npy file, hold anything else, or are more or fewer than the array.
    """
    file = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            shape, is_fortran, dtype = _READERS[npy.read_magic(file)](file)
    except Exception as error:
        reason = one_line(error, 80)
        raise ValueError(
            f"its header is damaged, or not of a .npy file of version 1, 2 or 3 ({reason})"
        ) from error
    if dtype.kind not in "biufcSU" or dtype.itemsize == 0:
        raise ValueError(f"its type is {one_line(dtype, 40)}; expected numbers, such as '<f8'")
    start, size = file.tell(), math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or start + size != len(data):
        raise ValueError(
            f"its size is not what its header says: {len(data) - start} bytes follow, and {dtype} "
            f"of shape {one_line(shape, 60)} have {size}"
        )
    array = np.frombuffer(data, dtype, math.prod(shape), start)
    if dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise ValueError("a boolean is neither 0 nor 1")
    if dtype.kind == "U":
        letters = array.view(np.dtype("u4").newbyteorder(dtype.byteorder))
        if (letters > sys.maxunicode).any():
            raise ValueError("a letter is none of Unicode's")
    return array.reshape(shape, order="F" if is_fortran else "C").copy(order="K")

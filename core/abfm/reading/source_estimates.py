"""Source estimates of MNE, .stc files: values at some vertices of a surface, in time.

Format, big-endian: milliseconds of the first sample and between samples as float32, how many
vertices and their numbers as uint32, how many samples as uint32, float32 values sample by sample
[MNE manual, appendix "The stc format"].
"""

import struct

import numpy as np

from abfm.numerics.real_numbers import as_float64
from abfm.reading.columns import Columns

_HEAD = struct.Struct(">ffI")


def read_stc(data: bytes) -> Columns:
    """Read one hemisphere, a column for each time; a ValueError reports what is wrong with it."""
    if len(data) < _HEAD.size:
        raise ValueError(f"it is cut off: it has {len(data)} bytes; its head alone has 12")
    begin, step, count = _HEAD.unpack_from(data)
    end = _HEAD.size + 4 * count
    if end + 4 > len(data):
        raise ValueError(f"it says to have {count} vertices, more than its {len(data)} bytes hold")
    vertices = np.frombuffer(data, ">u4", count, _HEAD.size).astype(np.int64)
    samples = int.from_bytes(data[end : end + 4], "big")
    if count == 0 or samples == 0:  # as MNE writes a hemisphere without sources
        raise ValueError(
            f"it holds {samples} samples of {count} vertices: this hemisphere has no sources. Use "
            "the file of the other one"
        )
    size = 4 * samples * count
    if len(data) - end - 4 != size:
        raise ValueError(
            f"it says to have {samples} samples of {count} values, {size} bytes, and "
            f"{len(data) - end - 4} follow"
        )
    if not (np.isfinite(begin) and np.isfinite(step) and step > 0):
        raise ValueError(
            f"its samples begin at {begin:g} ms and are {step:g} ms apart; expected finite times, "
            "each later than the one before"
        )
    values = np.frombuffer(data, ">f4", samples * count, end + 4).reshape(samples, count)
    times = (begin + step * np.arange(samples)) / 1000
    return Columns(as_float64(values).T, vertices=vertices, times=times)

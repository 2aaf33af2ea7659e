"""Reader of source estimates of MNE (.stc): time series at some vertices of a surface.

Format [MNE manual, appendix "The stc format"], big-endian:

- float32: time of the first sample, and time between samples, in milliseconds
- uint32: number of vertices, and their numbers
- uint32: number of samples
- float32: values, sample by sample
"""

import struct

import numpy as np

from abfm.numerics.real_numbers import as_float64
from abfm.reading.columns import Columns
from abfm.wording import counted

_HEAD = struct.Struct(">ffI")


def read_stc(data: bytes) -> Columns:
    """Read the values of one hemisphere, (n, T): a row for each vertex, a column for each time."""
    if len(data) < _HEAD.size:
        raise ValueError(
            f"the file is cut off: it has {len(data)} bytes, but its header alone has 12"
        )
    begin, step, count = _HEAD.unpack_from(data)
    end = _HEAD.size + 4 * count
    if end + 4 > len(data):
        raise ValueError(
            f"the file is cut off: {count} vertices need more than its {len(data)} bytes"
        )
    vertices = np.frombuffer(data, ">u4", count, _HEAD.size).astype(np.int64)
    samples = int.from_bytes(data[end : end + 4], "big")
    if count == 0 or samples == 0:  # MNE writes this for a hemisphere without sources
        raise ValueError(
            f"the file has {counted(samples, 'sample')} of "
            f"{counted(count, 'vertex', 'vertices')}, so this hemisphere has no "
            "sources. Use the file of the other hemisphere"
        )
    size = 4 * samples * count
    if len(data) - end - 4 != size:
        raise ValueError(
            f"{counted(samples, 'sample')} of {counted(count, 'value')} need {size} bytes, but "
            f"{len(data) - end - 4} follow the header. The file is damaged or cut off"
        )
    if not (np.isfinite(begin) and np.isfinite(step) and step > 0):
        raise ValueError(
            f"the samples begin at {begin:g} ms with steps of {step:g} ms; expected finite, "
            "increasing times"
        )
    values = np.frombuffer(data, ">f4", samples * count, end + 4).reshape(samples, count)
    times = (begin + step * np.arange(samples)) / 1000
    return Columns(as_float64(values).T, vertices=vertices, times=times)

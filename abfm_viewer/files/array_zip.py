"""Arrays and text as members of a zip without compression, so that no member can be larger than the file."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same content gives the same bytes


def write_text(archive: zipfile.ZipFile, name: str, text: str) -> None:
    """Add a member of UTF-8 text."""
    archive.writestr(zipfile.ZipInfo(name, _EPOCH), text)


def write_array(archive: zipfile.ZipFile, name: str, array: NDArray[Any]) -> None:
    """Add a member ``name.npy``."""
    with archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w", force_zip64=True) as file:
        np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)


def write_arrays(archive: zipfile.ZipFile, folder: str, names: Iterable[str], holder: object) -> None:
    """Add the attributes of an object, each as a member of a folder."""
    for name in names:
        write_array(archive, f"{folder}/{name}", getattr(holder, name))


def read_bytes(archive: zipfile.ZipFile, name: str) -> bytes:
    """The content of a member.

    Raises
    ------
    KeyError, ValueError, zipfile.BadZipFile, OSError
        If there is no such member, it is compressed or damaged, or cannot be read.
    """
    if archive.getinfo(name).compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} is compressed; expected a zip without compression")
    return archive.read(name)


def read_array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """The array of a member ``name.npy``: reals as float64, integers as int64.

    Raises
    ------
    KeyError, ValueError, zipfile.BadZipFile, OSError
        As `read_bytes`, and if it holds anything else, or not as much as it says.
    """
    file = io.BytesIO(read_bytes(archive, f"{name}.npy"))
    np.lib.format.read_magic(file)
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    if dtype.kind not in "fi":
        raise ValueError(f"{name} has type {dtype}; expected numbers")
    if file.tell() + math.prod(shape) * dtype.itemsize != len(file.getbuffer()):
        raise ValueError(f"{name} has another size than its shape {shape} says")
    file.seek(0)
    array = np.lib.format.read_array(file, allow_pickle=False)
    return np.asarray(array, np.float64 if dtype.kind == "f" else np.int64, order="C")


def read_arrays(archive: zipfile.ZipFile, folder: str, names: Iterable[str]) -> dict[str, Any]:
    """What `write_arrays` wrote, by name."""
    return {name: read_array(archive, f"{folder}/{name}") for name in names}

"""Data arrays and labels of GIFTI files; what they say of their size is held against what there is.

Format: https://www.nitrc.org/projects/gifti (version 1.0). Own code, as nibabel believes sizes,
expands what is compressed without a bound, and hangs or throws anything on files that are no GIFTI.
"""

import base64
import math
import os
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.reading.hemispheres import STRUCTURES
from abfm.reading.labels import Color
from abfm.reading.opening import Opened, open_file
from abfm.reading.plain_files import inflated, most_inflated, open_plain, referenced_file
from abfm.reading.xml_events import take_events

_INTEGERS = ("uint8", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_TYPES = {
    f"NIFTI_TYPE_{name.upper()}": np.dtype(name) for name in (*_INTEGERS, "float32", "float64")
}
_TYPES |= {  # numbers of NIfTI, which early files have in place of words
    str(number): np.dtype(name)
    for name, number in zip(
        (*_INTEGERS, "float32", "float64"),
        (2, 256, 4, 512, 8, 768, 1024, 1280, 16, 64),
        strict=True,
    )
}
# words of the standard, of early versions of nibabel and PyMVPA, and numbers
_ORDERS = {"LittleEndian": "<", "GIFTI_ENDIAN_LITTLE": "<", "2": "<"}
_ORDERS |= {"BigEndian": ">", "GIFTI_ENDIAN_BIG": ">", "1": ">"}
_LAYOUTS = {"RowMajorOrder": "C", "1": "C", "ColumnMajorOrder": "F", "2": "F"}
_ENCODINGS = {
    alias: words[0]
    for words in (
        ("ASCII", "GIFTI_ENCODING_ASCII", "1"),
        ("Base64Binary", "GIFTI_ENCODING_B64BIN", "2"),
        ("GZipBase64Binary", "GIFTI_ENCODING_B64GZ", "3"),
        ("ExternalFileBinary", "GIFTI_ENCODING_EXTBIN", "4"),
    )
    for alias in words
}
_INTENTS = {
    "0": "NIFTI_INTENT_NONE",
    "1002": "NIFTI_INTENT_LABEL",
    "1008": "NIFTI_INTENT_POINTSET",
    "1009": "NIFTI_INTENT_TRIANGLE",
    "2002": "NIFTI_INTENT_NODE_INDEX",
}
_SIDES = {structure: side for side, structure in STRUCTURES.items()}
_MOST_DIMENSIONS = 6
_TEXTS = ("Data", "Label", "Name", "Value")  # elements whose text is used
_LARGEST_KEY = 2**63 - 1
LABEL = "NIFTI_INTENT_LABEL"
"""The intent of arrays of keys, which the table of labels names."""
NODE_INDEX = "NIFTI_INTENT_NODE_INDEX"
"""The intent of arrays of the vertices that the rows of the others belong to."""
SURFACE = ("NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE")
"""The intents of the arrays of a mesh."""


class GiftiArray(NamedTuple):
    """One data array: what it is meant for, such as ``NIFTI_INTENT_POINTSET``, its values, and what
    its metadata call it, if anything.
    """

    intent: str
    values: NDArray[Any]
    name: str = ""


class Gifti(NamedTuple):
    """All data arrays of a file in its order, and its table of labels: names and colours by key;
    and how long its metadata say that it is from an array to the next, NaN if they do not.
    """

    arrays: list[GiftiArray]
    names: dict[int, str]
    colors: dict[int, Color]
    time_step: float = math.nan
    structure: str = ""
    """"L" or "R" where its metadata name a hemisphere (``AnatomicalStructurePrimary``)."""


def read_gifti(source: str | os.PathLike[str] | Opened) -> Gifti:
    """Read a GIFTI file.

    An OSError reports that the file, or one that it names, cannot be read, a ValueError that it is
    no GIFTI file, or an array not as large as announced.
    """
    opened = source if isinstance(source, Opened) else open_file(source)
    reader = _Reader(opened.path, most_inflated(len(opened.data)))
    take_events(opened.data, reader)
    return Gifti(reader.arrays, reader.names, reader.colors, reader.time_step, reader.structure)


class _Reader:
    """Takes arrays and labels from an XML parser's events; arrays may have so many bytes in all."""

    def __init__(self, path: Path, most: int) -> None:
        self._path, self._left = path, most
        self.arrays: list[GiftiArray] = []
        self.names: dict[int, str] = {}
        self.colors: dict[int, Color] = {}
        self.time_step, self.structure = math.nan, ""
        self._open: list[str] = []
        self._attributes: dict[str, str] = {}
        self._name, self._entry = "", ""  # of the array; of its metadata
        self._text: list[str] = []

    def start(self, name: str, attributes: dict[str, str]) -> None:
        if not self._open and name != "GIFTI":
            raise ValueError("it is XML, but not GIFTI")
        self._open.append(name)
        if name in ("DataArray", "Label"):
            self._attributes, self._name = attributes, ""
        if name in _TEXTS:
            self._text.clear()

    def characters(self, text: str) -> None:
        if self._open[-1] in _TEXTS:
            self._text.append(text)

    def end(self, name: str) -> None:
        self._open.pop()
        if name not in _TEXTS:
            return
        text = "".join(self._text)
        self._text.clear()
        if name == "Data":
            intent = self._attributes.get("Intent", "").strip()
            values = self._values(text)
            self.arrays.append(GiftiArray(_INTENTS.get(intent, intent), values, self._name))
        elif name == "Label":
            self._label(text.strip())
        elif name == "Name":
            self._entry = text.strip()
        elif self._entry == "TimeStep":
            self.time_step = _number(text)
        elif self._entry == "AnatomicalStructurePrimary":
            self.structure = self.structure or _SIDES.get(text.strip(), "")
        elif self._entry == "Name" and "DataArray" in self._open:
            self._name = text.strip()

    def _label(self, name: str) -> None:
        """Take a label, without its colour where it is none; early files call keys ``Index``."""
        word = self._attributes.get("Key", self._attributes.get("Index", ""))
        digits = word.removeprefix("-")
        if not (digits.isascii() and digits.isdigit() and len(digits) <= 19):
            raise ValueError(f"a label has the key {word[:40]!r}; expected a whole number")
        key = int(word)
        if abs(key) > _LARGEST_KEY:
            raise ValueError(f"a label has the key {key}; at most {_LARGEST_KEY} is expected")
        self.names[key] = name
        self.colors.pop(key, None)
        parts = [_number(self._attributes.get(part, "")) for part in ("Red", "Green", "Blue")]
        red, green, blue, opacity = *parts, _number(self._attributes.get("Alpha", "1"))
        if all(0 <= part <= 1 for part in (red, green, blue, opacity)):
            self.colors[key] = red, green, blue, opacity

    def _values(self, text: str) -> NDArray[Any]:
        """Return the array that the attributes describe."""
        kind = self._one_of("DataType", _TYPES, "")
        order = self._one_of("ArrayIndexingOrder", _LAYOUTS, "RowMajorOrder")
        stored = kind.newbyteorder(self._one_of("Endian", _ORDERS, "LittleEndian"))
        dimensions = self._whole("Dimensionality", "0")
        if not 0 < dimensions <= _MOST_DIMENSIONS:
            raise ValueError(
                f"an array has {dimensions} dimensions; expected 1 to {_MOST_DIMENSIONS}"
            )
        shape = tuple(self._whole(f"Dim{k}", "") for k in range(dimensions))
        encoding = self._one_of("Encoding", _ENCODINGS, "GZipBase64Binary")
        size = math.prod(shape) * (8 if encoding == "ASCII" else kind.itemsize)
        if size > self._left:
            raise ValueError(f"an array of shape {shape} is more than a file of this size may hold")
        self._left -= size
        if encoding == "ASCII":
            # one row a line is one row a line, as others read it
            if text.strip().count("\n") + 1 == shape[0]:
                order = "C"
            return _numbers(text, kind, math.prod(shape)).reshape(shape, order=order)
        if encoding == "ExternalFileBinary":
            name = self._attributes.get("ExternalFileName", "")
            with open_plain(referenced_file(self._path, name)) as f:
                if self._attributes.get("ExternalFileOffset"):  # which some write, and leave empty
                    f.seek(self._whole("ExternalFileOffset", "0"))
                data = f.read(size)
        else:
            data = base64.b64decode(text)
            if encoding == "GZipBase64Binary":
                data = inflated(data, size)
        if len(data) != size:
            raise ValueError(f"an array of shape {shape} has {len(data)} bytes; expected {size}")
        return np.frombuffer(data, stored).reshape(shape, order=order).astype(kind)

    def _one_of(self, name: str, known: dict[str, Any], default: str) -> Any:
        word = self._attributes.get(name, default).strip()
        if word not in known:
            words = ", ".join(each for each in known if not each.isdigit() and "GIFTI" not in each)
            raise ValueError(f"an array has the {name} {word[:40]!r}; expected {words}")
        return known[word]

    def _whole(self, name: str, default: str) -> int:
        text = self._attributes.get(name, default)
        if not (text.isascii() and text.isdigit() and len(text) <= 18):
            raise ValueError(
                f"an array has the {name} {text[:40]!r}; expected a whole number, 0 or more"
            )
        return int(text)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _numbers(text: str, kind: np.dtype[Any], count: int) -> NDArray[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older versions of NumPy warn of what is no number
        try:
            values = np.fromstring(text, dtype=kind, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise ValueError(
                f"an array of {count} numbers has something else among them"
            ) from error
    if len(values) != count:
        raise ValueError(f"an array of {count} numbers has {len(values)}")
    return values

"""Data arrays and labels of GIFTI files; what they say of their size is held against what there is.

Format: https://www.nitrc.org/projects/gifti (version 1.0). Own code, as nibabel believes sizes,
expands what is compressed without a bound, and hangs or throws anything on files that are no GIFTI.
"""

import base64
import binascii
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.reading.hemispheres import STRUCTURES
from abfm.reading.labels import Color
from abfm.reading.opening import Opened, open_file
from abfm.reading.plain_files import inflated, most_inflated, open_plain, referenced_file
from abfm.reading.xml_trees import count_in, meaning_of, numbers_in, xml_tree

_INTEGERS = ("uint8", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_NUMBERS = (2, 256, 4, 512, 8, 768, 1024, 1280, 16, 64)  # which early files have for words
_TYPES = {
    word: np.dtype(name)
    for name, number in zip((*_INTEGERS, "float32", "float64"), _NUMBERS, strict=True)
    for word in (f"NIFTI_TYPE_{name.upper()}", str(number))
}
# words of the standard, of early versions of nibabel and PyMVPA, and numbers
_ORDERS = {"LittleEndian": "<", "GIFTI_ENDIAN_LITTLE": "<", "2": "<"}
_ORDERS |= {"BigEndian": ">", "GIFTI_ENDIAN_BIG": ">", "1": ">"}
_LAYOUTS = {"RowMajorOrder": "C", "1": "C", "ColumnMajorOrder": "F", "2": "F"}
_ENCODINGS = dict.fromkeys(("ASCII", "GIFTI_ENCODING_ASCII", "1"), "ASCII")
_ENCODINGS |= dict.fromkeys(("Base64Binary", "GIFTI_ENCODING_B64BIN", "2"), "base64")
_ENCODINGS |= dict.fromkeys(("GZipBase64Binary", "GIFTI_ENCODING_B64GZ", "3"), "gzip")
_ENCODINGS |= dict.fromkeys(("ExternalFileBinary", "GIFTI_ENCODING_EXTBIN", "4"), "file")
_INTENTS = {
    "0": "NIFTI_INTENT_NONE",
    "1002": "NIFTI_INTENT_LABEL",
    "1008": "NIFTI_INTENT_POINTSET",
    "1009": "NIFTI_INTENT_TRIANGLE",
    "2002": "NIFTI_INTENT_NODE_INDEX",
}
_SIDES = {structure: side for side, structure in STRUCTURES.items()}
_MOST_DIMENSIONS = 6
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
    root, left = xml_tree(opened.data), most_inflated(len(opened.data))
    if root.tag != "GIFTI":
        raise ValueError("it is XML, but not GIFTI")
    arrays, names, colors = list[GiftiArray](), dict[int, str](), dict[int, Color]()
    for element in root.iter("DataArray"):
        name = dict(_metadata(element.findall("MetaData/MD"))).get("Name", "")
        intent = element.get("Intent", "").strip()
        for data in element.findall("Data"):
            values = _values(element, data.text or "", opened.path, left)
            left -= values.nbytes
            arrays.append(GiftiArray(_INTENTS.get(intent, intent), values, name))
    for element in root.iter("Label"):
        key, color = _key(element), _color(element)
        names[key] = (element.text or "").strip()
        colors.pop(key, None)
        if color:
            colors[key] = color
    metadata = _metadata(root.iter("MD"))
    steps = [_number(text) for name, text in metadata if name == "TimeStep"]
    sides = [_SIDES.get(text) for name, text in metadata if name == "AnatomicalStructurePrimary"]
    side = next(filter(None, sides), "")
    return Gifti(arrays, names, colors, steps[-1] if steps else math.nan, side)


def _metadata(entries: Iterable[Element]) -> list[tuple[str, str]]:
    """Return the names and values of entries."""
    pairs = ((entry.findtext("Name", ""), entry.findtext("Value", "")) for entry in entries)
    return [(name.strip(), value.strip()) for name, value in pairs]


def _key(label: Element) -> int:
    """Return the key of a label, which early files call ``Index``."""
    word = label.get("Key", label.get("Index", ""))
    digits = word.removeprefix("-")
    if not (digits.isascii() and digits.isdigit() and len(digits) <= 19):
        raise ValueError(f"a label has the key {brief(word)}; expected a whole number")
    if int(digits) > _LARGEST_KEY:
        raise ValueError(f"a label has the key {word}; at most {_LARGEST_KEY} is expected")
    return int(word)


def _color(label: Element) -> Color | None:
    """Return the colour of a label, if it has one."""
    parts = [_number(label.get(part, "")) for part in ("Red", "Green", "Blue")]
    red, green, blue, opacity = *parts, _number(label.get("Alpha", "1"))
    is_color = all(0 <= part <= 1 for part in (red, green, blue, opacity))
    return (red, green, blue, opacity) if is_color else None


def _values(array: Element, text: str, path: Path, most: int) -> NDArray[Any]:
    """Return what an element describes, of at most so many bytes; the text is in it."""
    kind = meaning_of(array, "DataType", _TYPES)
    order = meaning_of(array, "ArrayIndexingOrder", _LAYOUTS, "RowMajorOrder")
    stored = kind.newbyteorder(meaning_of(array, "Endian", _ORDERS, "LittleEndian"))
    dimensions = count_in(array, "Dimensionality", "0")
    if not 0 < dimensions <= _MOST_DIMENSIONS:
        raise ValueError(f"an array has {dimensions} dimensions; expected 1 to {_MOST_DIMENSIONS}")
    shape = tuple(count_in(array, f"Dim{k}") for k in range(dimensions))
    encoding = meaning_of(array, "Encoding", _ENCODINGS, "GZipBase64Binary")
    count = math.prod(shape)
    size = count * (8 if encoding == "ASCII" else kind.itemsize)
    if size > most:
        raise ValueError(f"an array of shape {shape} is more than a file of this size may hold")
    if encoding == "ASCII":
        if text.strip().count("\n") + 1 == shape[0]:
            order = "C"  # one row a line is one row a line, as others read it
        numbers = numbers_in(text, kind)
        if len(numbers) != count:
            raise ValueError(f"an array of {count} numbers has {len(numbers)}")
        return numbers.reshape(shape, order=order)
    if encoding == "file":
        with open_plain(referenced_file(path, array.get("ExternalFileName", ""))) as file:
            file.seek(count_in(array, "ExternalFileOffset", "0"))  # which some leave empty
            data = file.read(size)
    else:
        try:
            data = base64.b64decode(text)
        except binascii.Error as error:
            raise ValueError("the Base64 text of an array is cut off or damaged") from error
        if encoding == "gzip":
            data = inflated(data, size)
    if len(data) != size:
        raise ValueError(f"an array of shape {shape} has {len(data)} bytes; expected {size}")
    return np.frombuffer(data, stored).reshape(shape, order=order).astype(kind)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan

"""Reader of GIFTI files: data arrays and labels.

Format: https://www.nitrc.org/projects/gifti (version 1.0). The reader of nibabel is not used, as it
does not check announced sizes and decompresses without a bound. For files that are not GIFTI, it
hangs or raises errors of any type.
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
from abfm.reading.regular_files import inflated, inflated_size_max, open_regular, referenced_file
from abfm.reading.xml_trees import choice_in, count_in, numbers_in, xml_tree

_INTEGERS = ("uint8", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_NUMBERS = (2, 256, 4, 512, 8, 768, 1024, 1280, 16, 64)  # codes of the types in early files
_TYPES = {
    word: np.dtype(name)
    for name, number in zip((*_INTEGERS, "float32", "float64"), _NUMBERS, strict=True)
    for word in (f"NIFTI_TYPE_{name.upper()}", str(number))
}
# words of the standard, words of early versions of nibabel and PyMVPA, and numbers
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
_DIMENSIONS_MAX = 6
_KEY_MAX = 2**63 - 1
LABEL = "NIFTI_INTENT_LABEL"  # intent of arrays of label keys
NODE_INDEX = "NIFTI_INTENT_NODE_INDEX"  # intent of arrays of the vertex numbers of rows
SURFACE = ("NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE")  # intents of the arrays of a mesh


class GiftiArray(NamedTuple):
    """One data array: its intent, such as ``NIFTI_INTENT_POINTSET``, its values and its name."""

    intent: str
    values: NDArray[Any]
    name: str = ""


class Gifti(NamedTuple):
    """Contents of a GIFTI file."""

    arrays: list[GiftiArray]  # data arrays in the order of the file
    names: dict[int, str]  # names of labels by key
    colors: dict[int, Color]  # colours of labels by key
    time_step: float = math.nan  # time between arrays in the metadata, or NaN
    structure: str = ""
    """"L" or "R" if the metadata name a hemisphere (``AnatomicalStructurePrimary``), or empty."""


def read_gifti(source: str | os.PathLike[str] | Opened) -> Gifti:
    """Read a GIFTI file and its external files; OSError if unreadable, ValueError if invalid."""
    opened = source if isinstance(source, Opened) else open_file(source)
    root, budget = xml_tree(opened.data), inflated_size_max(len(opened.data))
    if root.tag != "GIFTI":
        raise ValueError("the file is XML, but not GIFTI")
    arrays, names, colors = list[GiftiArray](), dict[int, str](), dict[int, Color]()
    for element in root.iter("DataArray"):
        name = dict(_metadata(element.findall("MetaData/MD"))).get("Name", "")
        intent = element.get("Intent", "").strip()
        for data in element.findall("Data"):
            values = _values(element, data.text or "", opened.path, budget)
            budget -= values.nbytes
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
    pairs = ((entry.findtext("Name", ""), entry.findtext("Value", "")) for entry in entries)
    return [(name.strip(), value.strip()) for name, value in pairs]


def _key(label: Element) -> int:
    """Return the key of a label element, an attribute that early files call ``Index``."""
    word = label.get("Key", label.get("Index", ""))
    digits = word.removeprefix("-")
    if not (digits.isascii() and digits.isdigit() and len(digits) <= 19):
        raise ValueError(f"the key of a label is {brief(word)}; expected an integer")
    if int(digits) > _KEY_MAX:
        raise ValueError(f"the key of a label is {word}; expected at most {_KEY_MAX}")
    return int(word)


def _color(label: Element) -> Color | None:
    parts = [_number(label.get(part, "")) for part in ("Red", "Green", "Blue")]
    red, green, blue, opacity = *parts, _number(label.get("Alpha", "1"))
    is_color = all(0 <= part <= 1 for part in (red, green, blue, opacity))
    return (red, green, blue, opacity) if is_color else None


def _values(array: Element, text: str, path: Path, size_max: int) -> NDArray[Any]:
    """Return the numbers of a data array element with a text, of the GIFTI file ``path``.

    Raises ValueError if they have more than ``size_max`` bytes.
    """
    kind = choice_in(array, "DataType", _TYPES)
    order = choice_in(array, "ArrayIndexingOrder", _LAYOUTS, "RowMajorOrder")
    stored = kind.newbyteorder(choice_in(array, "Endian", _ORDERS, "LittleEndian"))
    dimensions = count_in(array, "Dimensionality", "0")
    if not 0 < dimensions <= _DIMENSIONS_MAX:
        raise ValueError(f"an array has {dimensions} dimensions; expected 1 to {_DIMENSIONS_MAX}")
    shape = tuple(count_in(array, f"Dim{k}") for k in range(dimensions))
    encoding = choice_in(array, "Encoding", _ENCODINGS, "GZipBase64Binary")
    count = math.prod(shape)
    size = count * (8 if encoding == "ASCII" else kind.itemsize)
    if size > size_max:
        raise ValueError(f"a file of this size cannot have an array of shape {shape}")
    if encoding == "ASCII":
        if text.strip().count("\n") + 1 == shape[0]:
            order = "C"  # a line is a row in any announced order, as in other readers
        numbers = numbers_in(text, kind)
        if len(numbers) != count:
            raise ValueError(f"an array has {len(numbers)} numbers; expected {count}")
        return numbers.reshape(shape, order=order)
    if encoding == "file":
        with open_regular(referenced_file(path, array.get("ExternalFileName", ""))) as file:
            file.seek(count_in(array, "ExternalFileOffset", "0"))  # offset empty in some files
            data = file.read(size)
    else:
        try:
            data = base64.b64decode(text)
        except binascii.Error as error:
            raise ValueError("the base64 text of an array is cut off or damaged") from error
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

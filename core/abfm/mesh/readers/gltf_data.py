"""The JSON and the buffers of a glTF 2.0 file; everything that one names in the other is looked at
before it is used.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

import base64
import binascii
import struct
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from abfm.reading import from_json, read_bytes
from abfm.types import FloatArray

_GLB, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WORDS = {dict: "object", list: "array", int: "whole number", str: "text"}  # of JSON
_COLUMNS = {"SCALAR": 1, "VEC3": 3}


class Node(NamedTuple):
    """A node of the scene: what it shows and the nodes below it, and how both are placed in what
    is above it.
    """

    mesh: int | None
    children: list[int]
    matrix: FloatArray


class Primitive(NamedTuple):
    """A part of a mesh: the accessors of its positions and of its corners, and what they make."""

    positions: int
    indices: int | None
    mode: int


class Document:
    """A glTF file.

    Raises
    ------
    ValueError
        Saying what is wrong with it; so do all of its methods.
    """

    def __init__(self, path: Path) -> None:
        data = read_bytes(path)
        self._path, self._binary = path, b""
        if path.suffix.lower() == ".glb":
            data, self._binary = _chunks(data)
        self._header = from_json(data)
        version = _of(self._header, "asset", dict, {}).get("version", "2.0")
        if not str(version).startswith("2."):
            raise ValueError(f"it is glTF {str(version)[:20]}; only glTF 2 is read")
        self._buffers: dict[Path | int, bytes] = {}

    def roots(self) -> list[int]:
        """Return the nodes of the scene that is to be shown; without scenes, those that are below
        no other.
        """
        if not _of(self._header, "scenes", list, []):
            nodes = range(len(_of(self._header, "nodes", list, [])))
            below = {
                child
                for index in nodes
                for child in _indices(self._entry("nodes", index), "children")
            }
            return [index for index in nodes if index not in below]
        return _indices(self._entry("scenes", _of(self._header, "scene", int, 0)), "nodes")

    def node(self, index: int) -> Node:
        entry = self._entry("nodes", index)
        matrix = _numbers(entry, "matrix", 16).reshape(4, 4).T if "matrix" in entry else np.eye(4)
        if "translation" in entry:
            moved = np.eye(4)
            moved[:3, 3] = _numbers(entry, "translation", 3)
            matrix = matrix @ moved
        if "rotation" in entry:
            matrix = matrix @ _rotation(np.roll(_numbers(entry, "rotation", 4), 1))
        if "scale" in entry:
            matrix = matrix @ np.diag(np.append(_numbers(entry, "scale", 3), 1.0))
        if not np.isfinite(matrix).all():
            raise ValueError(f"node {index} is placed by numbers that are not finite")
        return Node(_of(entry, "mesh", int, None), _indices(entry, "children"), matrix)

    def primitives(self, mesh: int) -> list[Primitive]:
        found = []
        for entry in _of(self._entry("meshes", mesh), "primitives", list, []):
            if not isinstance(entry, dict):
                raise ValueError(f"mesh {mesh} has a primitive that is no JSON object")
            positions = _of(_of(entry, "attributes", dict, {}), "POSITION", int, None)
            if positions is not None:  # others show nothing
                found.append(
                    Primitive(
                        positions, _of(entry, "indices", int, None), _of(entry, "mode", int, 4)
                    )
                )
        return found

    def numbers(self, index: int, shape: str) -> NDArray[Any]:
        """Return what an accessor gives, (count, 1 or 3)."""
        entry, name = self._entry("accessors", index), f"accessor {index}"
        if "sparse" in entry:
            raise ValueError(
                f"{name} is sparse, which is not read: export without sparse accessors"
            )
        if "bufferView" not in entry:
            raise ValueError(
                f"{name} has no buffer view: export without compression (Draco, meshopt)"
            )
        kind = np.dtype(_KINDS.get(_of(entry, "componentType", int, 0), "V0"))
        if (
            not kind.itemsize
            or entry.get("type") != shape
            or (shape == "SCALAR" and kind.kind == "f")
        ):
            raise ValueError(
                f"{name} is not made of {'corners' if shape == 'SCALAR' else 'positions'} as glTF "
                "has them"
            )
        view = self._entry("bufferViews", _of(entry, "bufferView", int, None))
        data = self._buffer(_of(view, "buffer", int, None))
        width = kind.itemsize * _COLUMNS[shape]
        start, size = _of(view, "byteOffset", int, 0), _of(view, "byteLength", int, 0)
        offset, count, step = (
            _of(entry, "byteOffset", int, 0),
            _of(entry, "count", int, 0),
            _of(view, "byteStride", int, width),
        )
        if min(start, offset, count) < 0 or step < width or start + size > len(data):
            raise ValueError(
                f"{name} and its buffer view ask for what the buffer of {len(data)} bytes does "
                "not have"
            )
        if count and offset + (count - 1) * step + width > size:
            raise ValueError(f"{name} announces {count} entries, more than its buffer view has")
        found = np.ndarray(
            (count, _COLUMNS[shape]),
            kind,
            data,
            start + offset if count else 0,
            (step, kind.itemsize),
        )
        if shape == "VEC3" and kind.kind != "f" and entry.get("normalized") is True:
            return np.maximum(found / np.iinfo(kind).max, -1.0)
        return found

    def _buffer(self, index: int) -> bytes:
        """Return the bytes of a buffer, wherever they are; read once."""
        uri = _of(self._entry("buffers", index), "uri", str, None)
        if uri is None:
            if index:
                raise ValueError(
                    f"buffer {index} has no data: export without compression (Draco, meshopt)"
                )
            return self._binary
        if not uri.startswith("data:"):
            path = (self._path.parent / unquote(uri)).resolve()
            if path not in self._buffers:
                self._buffers[path] = read_bytes(path)
            return self._buffers[path]
        if index not in self._buffers:
            try:
                self._buffers[index] = base64.b64decode(uri.partition("base64,")[2])
            except binascii.Error as error:
                raise ValueError(f"buffer {index} is no base64: {error}") from error
        return self._buffers[index]

    def _entry(self, name: str, index: int | None) -> dict[str, Any]:
        """Return one of the top-level objects of a kind."""
        entries = _of(self._header, name, list, [])
        if index is None or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
            raise ValueError(f"it names {name}[{index}], but has {len(entries)} {name}")
        found: dict[str, Any] = entries[index]
        return found


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """Return the JSON and binary chunk of a .glb file."""
    if len(data) < 20:
        raise ValueError("it is too short for a binary glTF file")
    magic, version, length, json_length, kind = struct.unpack_from("<5I", data)
    if magic != _GLB or version != 2 or kind != _JSON:
        raise ValueError("it does not begin as binary glTF 2 does")
    if length > len(data) or 20 + json_length > length:
        raise ValueError(
            f"it has {len(data)} bytes of {max(length, 20 + json_length)}: the file is cut off"
        )
    place = 20 + json_length
    while place + 8 <= length:
        size, kind = struct.unpack_from("<2I", data, place)
        place += 8
        if place + size > length:
            raise ValueError("a chunk of it is longer than the file: it is cut off")
        if kind == _BINARY:
            return data[20 : 20 + json_length], data[place : place + size]
        place += size
    return data[20 : 20 + json_length], b""


def _of(entry: Any, name: str, kind: type, default: Any) -> Any:
    """Return what a JSON object has under a name, of this type."""
    found = entry.get(name, default) if isinstance(entry, dict) else None
    if found is not default and (not isinstance(found, kind) or isinstance(found, bool)):
        raise ValueError(f"its {name} is no {_WORDS[kind]}, as glTF has it")
    return found


def _indices(entry: dict[str, Any], name: str) -> list[int]:
    found: list[int] = _of(entry, name, list, [])
    if not all(type(index) is int for index in found):
        raise ValueError(f"its {name} are no list of numbers, as glTF has it")
    return found


def _numbers(entry: dict[str, Any], name: str, count: int) -> FloatArray:
    found = _of(entry, name, list, None)
    if (
        found is None
        or len(found) != count
        or not all(isinstance(number, int | float) for number in found)
    ):
        raise ValueError(f"the {name} of a node is not made of {count} numbers")
    return np.array([float(number) for number in found])


def _rotation(quaternion: FloatArray) -> FloatArray:
    """Return the matrix (4, 4) of a quaternion w, x, y, z, of any length but 0, which turns
    nothing.
    """
    matrix, square = np.eye(4), quaternion @ quaternion
    if square < np.finfo(np.float64).eps * 4:
        return matrix
    q = quaternion * np.sqrt(2.0 / square)
    p = np.outer(q, q)
    matrix[:3, :3] = [
        [1.0 - p[2, 2] - p[3, 3], p[1, 2] - p[3, 0], p[1, 3] + p[2, 0]],
        [p[1, 2] + p[3, 0], 1.0 - p[1, 1] - p[3, 3], p[2, 3] - p[1, 0]],
        [p[1, 3] - p[2, 0], p[2, 3] + p[1, 0], 1.0 - p[1, 1] - p[2, 2]],
    ]
    return matrix

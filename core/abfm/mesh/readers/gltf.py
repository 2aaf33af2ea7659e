"""glTF scenes, as text (.gltf, with its buffers in it or beside it) and binary (.glb).

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html; triangles alone are read. Own
code: trimesh makes 2.4 GB and 19 s of 600 bytes that announce 100 million vertices, takes matrices
that are not finite, and leaves out what is sparse; pygltflib reads the JSON, and checks nothing.
"""

import base64
import binascii
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from abfm.mesh.readers.contents import FileContents, merge_by_position
from abfm.mesh.topology import edges_of_faces
from abfm.reading import from_json, read_bytes
from abfm.types import FloatArray, IntArray

TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives; the others are points and lines
_MOST_PARTS = 50_000  # of the scene: primitives, each as often as it is placed, and nodes
# vertices of all parts, over those that are in the file; so many may be anyway
_MOST_TIMES, _FEW = 4, 1_000_000
_GLB, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WORDS = {dict: "object", list: "array", int: "whole number", str: "text"}  # of JSON
_SHAPES = {"SCALAR": (1, "corners"), "VEC2": (2, "texture coordinates")}
_SHAPES |= {"VEC3": (3, "positions"), "VEC4": (4, "colours")}


class Part(NamedTuple):
    """Vertices (n, 3), faces, and the JSON of the primitive that they are of."""

    points: FloatArray
    faces: IntArray
    primitive: dict[str, Any]


def read_gltf(path: Path) -> FileContents:
    """Read all triangles of a scene, transformed as it says.

    glTF repeats a vertex wherever texture or normal are discontinuous. Where that leaves cracks,
    vertices at the same position are merged.
    """
    return joined(placed_parts(Document(path)))


def placed_parts(document: "Document") -> list[Part]:
    """Return what has triangles, as the scene places it."""
    meshes: dict[int, list[Part]] = {}
    parts: list[Part] = []
    there = placed = 0
    for mesh, matrix in document.placements():
        if mesh not in meshes:
            meshes[mesh] = list(document.parts(mesh))
            there += sum(len(part.points) for part in meshes[mesh])
        for part in meshes[mesh]:
            parts.append(_moved(part, matrix))
            placed += len(part.points)
        if len(parts) > _MOST_PARTS or placed > max(_FEW, _MOST_TIMES * there):
            raise ValueError(
                f"its scene shows its meshes again and again, more than {len(parts) - 1} times, "
                f"with {placed} vertices "
                f"where the file has {there}: export what is to be matched alone"
            )
    return parts


def joined(parts: list[Part]) -> FileContents:
    """Return the vertices and faces of all parts, merged by position where that closes cracks."""
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    vertices = np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)])
    shifted = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    split = FileContents(vertices, np.concatenate([np.zeros((0, 3), dtype=np.int64), *shifted]))
    if not split.faces.size or split.faces.max() >= len(vertices):
        return split
    merged = merge_by_position(split.vertices, split.faces)
    return merged if _boundary_length(merged) < _boundary_length(split) else split


def _moved(part: Part, matrix: FloatArray) -> Part:
    """Return a part as it is placed; what is mirrored keeps its outer side."""
    if np.array_equal(matrix, np.eye(4)):
        return part
    moved = (matrix @ np.column_stack([part.points, np.ones(len(part.points))]).T).T[:, :3]
    faces = part.faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else part.faces
    return Part(moved, faces, part.primitive)


def _boundary_length(contents: FileContents) -> int:
    _, face_edges = edges_of_faces(contents.faces, len(contents.vertices))
    return int(np.sum(np.bincount(face_edges.ravel()) == 1))


class Document:
    """The JSON and the buffers of a file; what they name is looked at before it is used."""

    def __init__(self, path: Path) -> None:
        data = read_bytes(path)
        self._path, self._binary = path, b""
        if path.suffix.lower() == ".glb":
            data, self._binary = _chunks(data)
        self._header = from_json(data)
        version = of(self._header, "asset", dict, {}).get("version", "2.0")
        if not str(version).startswith("2."):
            raise ValueError(f"it is glTF {str(version)[:20]}; only glTF 2 is read")
        self._buffers: dict[Path | str, bytes] = {}

    def placements(self) -> Iterator[tuple[int, FloatArray]]:
        """Return mesh and transformation (4, 4) of every node that has a mesh, parents first."""
        seen: set[int] = set()
        left = [(root, np.eye(4)) for root in self._roots()]
        while left:
            index, above = left.pop()
            if index in seen or len(seen) > _MOST_PARTS:
                again = index in seen
                reason = "is in the scene twice" if again else f"is beyond the first {_MOST_PARTS}"
                raise ValueError(f"node {index} {reason}: export what is to be matched alone")
            seen.add(index)
            node = self.entry("nodes", index)
            matrix = above @ _matrix(node, index)
            mesh = of(node, "mesh", int, None)
            children = _indices(node, "children")
            if mesh is not None:
                yield mesh, matrix
            left.extend((child, matrix) for child in children)

    def _roots(self) -> list[int]:
        """Return the nodes of the scene that is shown; without scenes, those below no other."""
        if of(self._header, "scenes", list, []):
            return _indices(self.entry("scenes", of(self._header, "scene", int, 0)), "nodes")
        nodes = range(len(of(self._header, "nodes", list, [])))
        below = {child for k in nodes for child in _indices(self.entry("nodes", k), "children")}
        return [index for index in nodes if index not in below]

    def parts(self, mesh: int) -> Iterator[Part]:
        """Return the vertices and faces of the primitives of a mesh that have triangles."""
        for entry in of(self.entry("meshes", mesh), "primitives", list, []):
            if not isinstance(entry, dict):
                raise ValueError(f"mesh {mesh} has a primitive that is no JSON object")
            positions = of(of(entry, "attributes", dict, {}), "POSITION", int, None)
            if positions is None:  # which shows nothing
                continue
            indices, mode = of(entry, "indices", int, None), of(entry, "mode", int, TRIANGLES)
            if mode not in (TRIANGLES, STRIP, FAN):
                continue
            points = self.numbers(positions, "VEC3").astype(np.float64)
            corners = np.arange(len(points))
            if indices is not None:
                corners = self.numbers(indices, "SCALAR").astype(np.int64).ravel()
            if mode == TRIANGLES and len(corners) % 3:
                raise ValueError(
                    f"mesh {mesh} has {len(corners)} corners, which do not make whole triangles"
                )
            faces = _faces(corners, mode)
            if faces.size and faces.max() >= len(points):
                raise ValueError(
                    f"mesh {mesh} names vertex {faces.max()} of {len(points)} numbered from 0"
                )
            yield Part(points, faces, entry)

    def numbers(self, index: int, shape: str) -> NDArray[Any]:
        """Return what an accessor gives, (count, columns of the shape)."""
        entry, name = self.entry("accessors", index), f"accessor {index}"
        if "sparse" in entry:
            raise ValueError(
                f"{name} is sparse, which is not read: export without sparse accessors"
            )
        if "bufferView" not in entry:
            raise ValueError(
                f"{name} has no buffer view: export without compression (Draco, meshopt)"
            )
        columns, meaning = _SHAPES[shape]
        kind = np.dtype(_KINDS.get(of(entry, "componentType", int, 0), "V0"))
        right = kind.itemsize and entry.get("type") == shape
        if not right or (shape == "SCALAR" and kind.kind == "f"):
            raise ValueError(f"{name} is not made of {meaning} as glTF has them")
        view = self.entry("bufferViews", of(entry, "bufferView", int, None))
        data = self._buffer(of(view, "buffer", int, None))
        width = kind.itemsize * columns
        start, size = of(view, "byteOffset", int, 0), of(view, "byteLength", int, 0)
        offset, count = of(entry, "byteOffset", int, 0), of(entry, "count", int, 0)
        step = of(view, "byteStride", int, width)
        if min(start, offset, count) < 0 or step < width or start + size > len(data):
            raise ValueError(
                f"{name} and its buffer view ask for what the buffer of {len(data)} bytes does "
                "not have"
            )
        if count and offset + (count - 1) * step + width > size:
            raise ValueError(f"{name} announces {count} entries, more than its buffer view has")
        place = start + offset if count else 0
        found = np.ndarray((count, columns), kind, data, place, (step, kind.itemsize))
        if shape != "SCALAR" and kind.kind != "f" and entry.get("normalized") is True:
            return np.maximum(found / np.iinfo(kind).max, -1.0)
        return found

    def image(self, index: int | None) -> bytes:
        """Return the bytes of an image's file."""
        entry = self.entry("images", index)
        uri = of(entry, "uri", str, None)
        if uri is not None:
            return self._named(uri, f"image {index}")
        view = self.entry("bufferViews", of(entry, "bufferView", int, None))
        data = self._buffer(of(view, "buffer", int, None))
        start, size = of(view, "byteOffset", int, 0), of(view, "byteLength", int, 0)
        if min(start, size) < 0 or start + size > len(data):
            raise ValueError(
                f"image {index} asks for what the buffer of {len(data)} bytes does not have"
            )
        return data[start : start + size]

    def _buffer(self, index: int) -> bytes:
        """Return the bytes of a buffer, wherever they are; read once."""
        uri = of(self.entry("buffers", index), "uri", str, None)
        if uri is not None:
            return self._named(uri, f"buffer {index}")
        if index:
            raise ValueError(
                f"buffer {index} has no data: export without compression (Draco, meshopt)"
            )
        return self._binary

    def _named(self, uri: str, what: str) -> bytes:
        """Return the bytes that are in a text, or in the file that it names; read once."""
        if not uri.startswith("data:"):
            path = (self._path.parent / unquote(uri)).resolve()
            if path not in self._buffers:
                self._buffers[path] = read_bytes(path)
            return self._buffers[path]
        if what not in self._buffers:
            try:
                self._buffers[what] = base64.b64decode(uri.partition("base64,")[2])
            except binascii.Error as error:
                raise ValueError(f"{what} is no base64: {error}") from error
        return self._buffers[what]

    def entry(self, name: str, index: int | None) -> dict[str, Any]:
        """Return one of the top-level objects of a kind."""
        entries = of(self._header, name, list, [])
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
    place = 20 + json_length
    if length > len(data) or place > length:
        raise ValueError(f"it has {len(data)} bytes of {max(length, place)}: the file is cut off")
    json = data[20:place]
    while place + 8 <= length:
        size, kind = struct.unpack_from("<2I", data, place)
        place += 8
        if place + size > length:
            raise ValueError("a chunk of it is longer than the file: it is cut off")
        if kind == _BINARY:
            return json, data[place : place + size]
        place += size
    return json, b""


def of(entry: Any, name: str, kind: type, default: Any) -> Any:
    """Return what a JSON object has under a name, of this type."""
    found = entry.get(name, default) if isinstance(entry, dict) else None
    if found is not default and (not isinstance(found, kind) or isinstance(found, bool)):
        raise ValueError(f"its {name} is no {_WORDS[kind]}, as glTF has it")
    return found


def _indices(entry: dict[str, Any], name: str) -> list[int]:
    found: list[int] = of(entry, name, list, [])
    if not all(type(index) is int for index in found):
        raise ValueError(f"its {name} are no list of numbers, as glTF has it")
    return found


def _faces(corners: IntArray, mode: int) -> IntArray:
    """Return the triangles (F, 3) that corners make."""
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    first = corners[:-2] if mode == STRIP else np.repeat(corners[:1], max(len(corners) - 2, 0))
    faces = np.stack([first, corners[1:-1], corners[2:]], axis=1)
    if mode == STRIP:
        faces[1::2] = faces[1::2, ::-1]
    return faces


def numbers_of(entry: dict[str, Any], name: str, count: int, what: str = "node") -> FloatArray:
    """Return the numbers (count,) that a JSON object has under a name."""
    found = of(entry, name, list, None)
    are_numbers = found is not None and all(isinstance(each, int | float) for each in found)
    if not are_numbers or len(found) != count:
        raise ValueError(f"the {name} of a {what} is not made of {count} numbers")
    return np.array([float(each) for each in found])


def _matrix(node: dict[str, Any], index: int) -> FloatArray:
    """Return how a node is placed in what is above it, (4, 4)."""
    matrix = numbers_of(node, "matrix", 16).reshape(4, 4).T if "matrix" in node else np.eye(4)
    if "translation" in node:
        moved = np.eye(4)
        moved[:3, 3] = numbers_of(node, "translation", 3)
        matrix = matrix @ moved
    if "rotation" in node:
        matrix = matrix @ _rotation(np.roll(numbers_of(node, "rotation", 4), 1))
    if "scale" in node:
        matrix = matrix @ np.diag(np.append(numbers_of(node, "scale", 3), 1.0))
    if not np.isfinite(matrix).all():
        raise ValueError(f"node {index} is placed by numbers that are not finite")
    return matrix


def _rotation(quaternion: FloatArray) -> FloatArray:
    """Return the matrix (4, 4) of a quaternion w, x, y, z; of length 0, it turns nothing."""
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

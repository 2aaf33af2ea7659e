"""The JSON and the buffers of a glTF file.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html; only triangles are read. Existing
readers do not check enough. For 600 bytes that announce 100 million vertices, trimesh needs 2.4 GB
and 19 s. It also accepts matrices that are not finite, and ignores sparse data. The package
pygltflib reads only the JSON, without checks.
"""

import base64
import binascii
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from abfm.mesh.readers.references import References
from abfm.reading import Format, Opened, from_json, triangles_of_strips
from abfm.types import FloatArray, IntArray

TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives; the others are points and lines
PARTS_MAX = 50_000  # number of nodes, and of primitives, counted as often as they are placed
# A file must have this many bytes for each vertex and face of the scene, unless the scene has fewer
# than the second number.
_BYTES_EACH = 3
_ENTRIES_MIN = 1_000_000
_INSTANCES = "EXT_mesh_gpu_instancing"
_GLB = 0x46546C67
_JSON = 0x4E4F534A
_BINARY = 0x004E4942
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {"SCALAR": (1, "corners"), "VEC2": (2, "texture coordinates"), "VEC3": (3, "positions")}
_SHAPES |= {"VEC4": (4, "colours, joints or weights"), "MAT4": (16, "matrices")}
# names of types in JSON
_TYPE_NAMES = {dict: "an object", list: "an array", int: "an integer", str: "a text"}


def of(entry: Any, name: str, kind: type, default: Any) -> Any:
    """Return the value of a JSON object under a name, or the default if it has no such name.

    Raises ValueError if the entry is not an object, or the value is not of type ``kind``.
    """
    found = entry.get(name, default) if isinstance(entry, dict) else None
    if found is not default and (not isinstance(found, kind) or isinstance(found, bool)):
        raise ValueError(f"the value of {name} has a wrong type; expected {_TYPE_NAMES[kind]}")
    return found


def indices_of(entry: dict[str, Any], name: str) -> list[int]:
    found: list[int] = of(entry, name, list, [])
    if not all(type(index) is int for index in found):
        raise ValueError(f"the value of {name} has a wrong type; expected a list of integers")
    return found


def numbers_of(entry: dict[str, Any], name: str, count: int, what: str = "node") -> FloatArray:
    """Return ``count`` numbers of a JSON object under a name; errors call the object ``what``."""
    found = of(entry, name, list, None)
    are_numbers = found is not None and all(isinstance(each, int | float) for each in found)
    if not are_numbers or len(found) != count:
        raise ValueError(f"the value {name} of a {what} is not a list of {count} numbers")
    return np.array([float(each) for each in found])


class Part(NamedTuple):
    """Vertices (n, 3), faces (F, 3) and JSON object of a glTF primitive.

    Primitives that share vertices have the same array of vertices.
    """

    points: FloatArray
    faces: IntArray
    primitive: dict[str, Any]


class Document:
    """The JSON and the buffers of a file; every reference is checked before it is used."""

    def __init__(self, opened: Opened) -> None:
        data, self._binary = opened.data, b""
        if opened.format is Format.GLB:
            data, self._binary = _chunks(data)
        self._header = from_json(data)
        version = of(self._header, "asset", dict, {}).get("version", "2.0")
        if not str(version).startswith("2."):
            raise ValueError(
                f"the version of glTF is {str(version)[:20]}; only glTF 2 is supported"
            )
        self.is_animated = bool(of(self._header, "animations", list, []))
        self._references, self._texts = References(opened.path), dict[str, bytes]()
        self._images: dict[tuple[int, int, int], bytes] = {}
        self._size, self._counted = len(opened.data), 0
        self._arrays: dict[tuple[int, str, bool], NDArray[Any]] = {}
        self._matrices, self._joints = dict[int, FloatArray](), dict[int, FloatArray]()

    def count(self, entries: int) -> None:
        """Add a number of vertices or faces; ValueError if the file is too small for the total."""
        self._counted += entries
        size = self._size + self._references.size
        if self._counted > max(_ENTRIES_MIN, size // _BYTES_EACH):
            raise ValueError(
                f"the scene repeats its meshes too often: it has {self._counted} vertices and "
                f"faces, but the file has {size} bytes. Export the surface to be matched alone"
            )

    def placements(self) -> Iterator[tuple[dict[str, Any], FloatArray]]:
        """Yield every node that has a mesh, and its transformation (4, 4); parents come first."""
        pending = [(root, np.eye(4)) for root in self._roots()]
        seen = self._matrices
        while pending:
            index, above = pending.pop()
            if index in seen or len(seen) > PARTS_MAX:
                repeats = index in seen
                reason = "is in the scene twice" if repeats else f"is beyond the first {PARTS_MAX}"
                raise ValueError(f"node {index} {reason}. Export the surface to be matched alone")
            node = self.entry("nodes", index)
            if _INSTANCES in of(node, "extensions", dict, {}):
                raise ValueError(
                    f"node {index} has {_INSTANCES}, which is not supported. Export copies instead"
                )
            seen[index] = above @ _matrix(node, index)
            children = indices_of(node, "children")
            if of(node, "mesh", int, None) is not None:
                yield node, seen[index]
            pending.extend((child, seen[index]) for child in children)

    def joint_matrices(self, skin: int) -> FloatArray:
        """Return the matrices of the joints of a skin, (J, 4, 4), which move its vertices."""
        if skin not in self._joints:
            entry = self.entry("skins", skin)
            joints = indices_of(entry, "joints")
            if missing := [joint for joint in joints if joint not in self._matrices]:
                raise ValueError(f"skin {skin} has joint {missing[0]}, which is not in the scene")
            placed = np.array([self._matrices[joint] for joint in joints]).reshape(-1, 4, 4)
            inverse = of(entry, "inverseBindMatrices", int, None)
            if inverse is not None:
                found = self.numbers(inverse, "MAT4")[: len(joints)].reshape(-1, 4, 4)
                if len(found) < len(joints):
                    raise ValueError(
                        f"skin {skin} has {len(found)} inverse bind matrices for {len(joints)} "
                        "joints; expected one for each joint"
                    )
                placed = placed @ found.transpose(0, 2, 1)  # the file stores columns
            self._joints[skin] = placed
        return self._joints[skin]

    def _roots(self) -> list[int]:
        """Return the root nodes of the default scene; without scenes, all nodes with no parent."""
        if of(self._header, "scenes", list, []):
            return indices_of(self.entry("scenes", of(self._header, "scene", int, 0)), "nodes")
        nodes = range(len(of(self._header, "nodes", list, [])))
        below = {child for k in nodes for child in indices_of(self.entry("nodes", k), "children")}
        return [index for index in nodes if index not in below]

    def parts(self, mesh: int) -> Iterator[Part]:
        """Yield a `Part` for each primitive with triangles of a mesh."""
        positions_of: dict[int, FloatArray] = {}
        for entry in of(self.entry("meshes", mesh), "primitives", list, []):
            if not isinstance(entry, dict):
                raise ValueError(f"mesh {mesh} has a primitive that is not a JSON object")
            positions = of(of(entry, "attributes", dict, {}), "POSITION", int, None)
            if positions is None:  # the primitive is invisible
                continue
            indices, mode = of(entry, "indices", int, None), of(entry, "mode", int, TRIANGLES)
            if mode not in (TRIANGLES, STRIP, FAN):
                continue
            if positions not in positions_of:
                positions_of[positions] = self.numbers(positions, "VEC3").astype(np.float64)
                self.count(len(positions_of[positions]))
            points = positions_of[positions]
            corners = np.arange(len(points))
            if indices is not None:
                corners = self.numbers(indices, "SCALAR").astype(np.int64).ravel()
            if mode == TRIANGLES and len(corners) % 3:
                raise ValueError(
                    f"mesh {mesh} has {len(corners)} corners; expected a multiple of 3 for "
                    "triangles"
                )
            faces = _faces(corners, mode)
            self.count(len(faces))
            if faces.size and faces.max() >= len(points):
                raise ValueError(
                    f"mesh {mesh} refers to vertex {faces.max()}, but its {len(points)} vertices "
                    "are numbered from 0"
                )
            yield Part(points, faces, entry)

    def numbers(self, index: int, shape: str) -> NDArray[Any]:
        """Return the numbers of an accessor of type ``shape``, such as "VEC3": (count, columns)."""
        entry, name = self.entry("accessors", index), f"accessor {index}"
        if "bufferView" not in entry and "sparse" not in entry:
            raise ValueError(
                f"{name} has no buffer view. Export without compression (Draco, meshopt)"
            )
        columns, meaning = _SHAPES[shape]
        kind = np.dtype(_KINDS.get(of(entry, "componentType", int, 0), "V0"))
        is_valid = kind.itemsize and entry.get("type") == shape
        if not is_valid or (shape == "SCALAR" and kind.kind == "f"):
            raise ValueError(f"{name} does not have the type that glTF requires for {meaning}")
        count = of(entry, "count", int, 0)
        if "bufferView" in entry:
            found = self._viewed(entry, count, kind, columns, name)
        else:
            self.count(count)
            found = np.zeros((max(count, 0), columns), kind)
        if sparse := of(entry, "sparse", dict, {}):
            found = self._with_entries(found, sparse, name)
        if shape != "SCALAR" and kind.kind != "f" and entry.get("normalized") is True:
            return np.maximum(found / np.iinfo(kind).max, -1.0)
        return found

    def _viewed(
        self, entry: dict[str, Any], count: int, kind: np.dtype[Any], columns: int, name: str
    ) -> NDArray[Any]:
        """Return numbers (count, columns) of type ``kind`` from the buffer view of a JSON entry.

        ValueError, which calls the entry ``name``, if they exceed the view or its buffer.
        """
        view = self.entry("bufferViews", of(entry, "bufferView", int, None))
        data = self._buffer(of(view, "buffer", int, None))
        width, offset = kind.itemsize * columns, of(entry, "byteOffset", int, 0)
        start, size = of(view, "byteOffset", int, 0), of(view, "byteLength", int, 0)
        step = of(view, "byteStride", int, width)
        if min(start, offset, count) < 0 or step < width or start + size > len(data):
            raise ValueError(
                f"{name} and its buffer view exceed the buffer of {len(data)} bytes; the file may "
                "be cut off"
            )
        if count and offset + (count - 1) * step + width > size:
            raise ValueError(
                f"{name} announces {count} entries, which is more than its buffer view has"
            )
        place = start + offset if count else 0
        return np.ndarray((count, columns), kind, data, place, (step, kind.itemsize))

    def _with_entries(self, found: NDArray[Any], sparse: dict[str, Any], name: str) -> NDArray[Any]:
        """Return a copy of ``found``, in which a sparse accessor replaces some rows."""
        count = of(sparse, "count", int, 0)
        at, values = (of(sparse, part, dict, {}) for part in ("indices", "values"))
        kind = np.dtype(_KINDS.get(of(at, "componentType", int, 0), "V0"))
        if kind.kind != "u":
            raise ValueError(f"the indices of the sparse {name} are not integers")
        places = self._viewed(at, count, kind, 1, f"the indices of {name}").ravel()
        if places.size and places.max() >= len(found):
            raise ValueError(
                f"the sparse {name} refers to entry {places.max()}, but its {len(found)} entries "
                "are numbered from 0"
            )
        self.count(len(found))
        replaced, what = found.copy(), f"the values of {name}"
        replaced[places] = self._viewed(values, count, found.dtype, found.shape[1], what)
        return replaced

    def at_vertices(
        self, part: Part, index: int, shape: str, as_shares: bool = True
    ) -> NDArray[Any]:
        """Return the rows of an accessor; ValueError unless there is one for each vertex of a part.

        If ``as_shares``, integers are divided by the largest value of their type.
        """
        key = index, shape, as_shares
        if key not in self._arrays:
            found = self.numbers(index, shape)
            self.count(len(found))
            is_scaled = as_shares and found.dtype.kind != "f"
            self._arrays[key] = found / np.iinfo(found.dtype).max if is_scaled else found
        found = self._arrays[key]
        if len(found) != len(part.points):
            raise ValueError(
                f"accessor {index} has {len(found)} entries for {len(part.points)} vertices; "
                "expected one for each vertex"
            )
        return found

    def image(self, index: int | None) -> bytes:
        """Return the bytes of the image with an index; repeated calls return the same object."""
        entry = self.entry("images", index)
        uri = of(entry, "uri", str, None)
        if uri is not None:
            return self._named(uri, f"image {index}")
        view = self.entry("bufferViews", of(entry, "bufferView", int, None))
        buffer = of(view, "buffer", int, None)
        data = self._buffer(buffer)
        start, size = of(view, "byteOffset", int, 0), of(view, "byteLength", int, 0)
        if min(start, size) < 0 or start + size > len(data):
            raise ValueError(
                f"image {index} exceeds the buffer of {len(data)} bytes; the file may be cut off"
            )
        if (buffer, start, size) not in self._images:
            self._references.spend(size, f"image {index}")
            self._images[buffer, start, size] = data[start : start + size]
        return self._images[buffer, start, size]

    def _buffer(self, index: int | None) -> bytes:
        """Return the bytes of a buffer, embedded or in a separate file; each is read only once."""
        uri = of(self.entry("buffers", index), "uri", str, None)
        if uri is not None:
            return self._named(uri, f"buffer {index}")
        if index:
            raise ValueError(
                f"buffer {index} has no data. Export without compression (Draco, meshopt)"
            )
        return self._binary

    def _named(self, uri: str, what: str) -> bytes:
        """Return the bytes of a data URI, or of a URI's file; error messages call it ``what``."""
        if what not in self._texts:
            if not uri.startswith("data:"):
                content = self._references.read(unquote(uri))
            else:
                try:
                    content = base64.b64decode(uri.partition("base64,")[2])
                except binascii.Error as error:
                    raise ValueError(f"{what} is not valid base64: {error}") from error
            self._texts[what] = content
        return self._texts[what]

    def entry(self, name: str, index: int | None) -> dict[str, Any]:
        """Return an object of a top-level JSON array, such as "nodes"; ValueError if missing."""
        entries = of(self._header, name, list, [])
        if index is None or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
            raise ValueError(
                f"the file refers to {name}[{index}], but its {len(entries)} {name} are numbered "
                "from 0"
            )
        found: dict[str, Any] = entries[index]
        return found


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    if len(data) < 20:
        raise ValueError("the file is too short for binary glTF; it may be cut off")
    magic, version, length, json_length, kind = struct.unpack_from("<5I", data)
    if magic != _GLB or version != 2 or kind != _JSON:
        raise ValueError("the file does not begin with the header of binary glTF 2")
    place = 20 + json_length
    if length > len(data) or place > length:
        raise ValueError(f"the file is cut off: it has {len(data)} of {max(length, place)} bytes")
    json = data[20:place]
    while place + 8 <= length:
        size, kind = struct.unpack_from("<2I", data, place)
        place += 8
        if place + size > length:
            raise ValueError("the file is cut off: one of its chunks is longer than the file")
        if kind == _BINARY:
            return json, data[place : place + size]
        place += size
    return json, b""


def _faces(corners: IntArray, mode: int) -> IntArray:
    """Return the triangles (F, 3) of corners, by the glTF mode: separate, a strip or a fan."""
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == STRIP:
        return triangles_of_strips(np.array([len(corners)]), corners)
    first = np.repeat(corners[:1], max(len(corners) - 2, 0))
    return np.stack([first, corners[1:-1], corners[2:]], axis=1)


def _matrix(node: dict[str, Any], index: int) -> FloatArray:
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
        raise ValueError(f"the transformation of node {index} has numbers that are not finite")
    return matrix


def _rotation(quaternion: FloatArray) -> FloatArray:
    """Return the matrix (4, 4) of a quaternion w, x, y, z; the identity if its length is 0."""
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

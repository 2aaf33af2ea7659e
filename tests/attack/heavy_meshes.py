"""Mesh files that make their readers work and keep as much as files of their size can."""

from __future__ import annotations

import base64
import gzip
import json
import struct
import zlib
from collections.abc import Callable

import numpy as np


def filled(beginning: bytes, piece: bytes, size: int, end: bytes = b"") -> bytes:
    """The piece again and again, as often as the size allows."""
    return beginning + piece * ((size - len(beginning) - len(end)) // len(piece)) + end


def ply_header(kind: str, *lines: str) -> bytes:
    return "\n".join(["ply", f"format {kind} 1.0", *lines, "end_header", ""]).encode()


XYZ = ("property float x", "property float y", "property float z")
CORNERS = "property list uchar int vertex_indices"


def gltf_header(**changes: object) -> dict[str, object]:
    """Of a scene with one triangle in the first 48 bytes of its only buffer, in which anything can be replaced."""
    header: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 48}],
    }
    return {name: part for name, part in (header | changes).items() if part is not None}


TRIANGLE = struct.pack("<9f3I", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 2)


def glb(header: dict[str, object] | bytes, data: bytes = TRIANGLE) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _grid(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (side^2, 3) and faces of a bumpy square."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + side, a + 1], 1), np.stack([a + 1, a + side, a + side + 1], 1)])
    return np.stack([x, y, np.sin(x) + np.cos(y)], axis=1), faces


def _as_off(size: int) -> bytes:
    vertices, faces = _grid(int((size / 42) ** 0.5))
    lines = [f"OFF\n{len(vertices)} {len(faces)} 0\n"]
    lines += [f"{x} {y} {z:.2f}\n" for x, y, z in vertices.tolist()]
    return "".join([*lines, *(f"3 {a} {b} {c}\n" for a, b, c in faces.tolist())]).encode()


def _as_obj(size: int) -> bytes:
    vertices, faces = _grid(int((size / 42) ** 0.5))
    lines = [f"v {x} {y} {z:.2f}\n" for x, y, z in vertices.tolist()]
    return "".join([*lines, *(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())]).encode()


def _as_stl(size: int) -> bytes:
    vertices, faces = _grid(int((size / 100) ** 0.5))
    record = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
    record["corners"] = vertices[faces]
    return bytes(80) + struct.pack("<I", len(faces)) + record.tobytes()


def _as_ply(size: int) -> bytes:
    vertices, faces = _grid(int((size / 38) ** 0.5))
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    header = ply_header(
        "binary_little_endian", f"element vertex {len(vertices)}", *XYZ, f"element face {len(faces)}", CORNERS
    )
    return header + vertices.astype("<f4").tobytes() + rows.tobytes()


def _gltf_data(vertices: np.ndarray, faces: np.ndarray, **changes: object) -> bytes:
    points, corners = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    return glb(
        gltf_header(
            accessors=[
                {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
                {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
            ],
            bufferViews=[
                {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
                {"buffer": 0, "byteOffset": len(points), "byteLength": len(corners)},
            ],
            buffers=[{"byteLength": len(points + corners)}],
            **changes,
        ),
        points + corners,
    )


def _as_glb(size: int) -> bytes:
    return _gltf_data(*_grid(int((size / 36) ** 0.5)))


def _soup_glb(size: int) -> bytes:
    corners = np.random.default_rng(0).random((size // 12 // 3 * 3, 3))
    return glb(
        gltf_header(
            meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
            accessors=[{"bufferView": 0, "componentType": 5126, "count": len(corners), "type": "VEC3"}],
            bufferViews=[{"buffer": 0, "byteLength": 12 * len(corners)}],
        ),
        corners.astype("<f4").tobytes(),
    )


def _off_rows(size: int, vertex: bytes, face: bytes, share: float) -> bytes:
    vertices, faces = int(size * share / len(vertex)), int(size * (1 - share) / len(face))
    return b"OFF\n%d %d 0\n" % (vertices, faces) + vertex * vertices + face * faces


def _polygon(size: int, kind: str) -> bytes:
    """A single polygon with as many corners as fit, a circle or a random jagged star."""
    count = size // 52
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    radius = 1 + (0 if kind == "convex" else 0.5) * np.random.default_rng(0).random(count)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    lines = ["OFF", f"{count} 1 0", *(f"{x!r} {y!r} 0" for x, y in points.tolist()), f"{count} "]
    return ("\n".join(lines) + " ".join(map(str, range(count)))).encode()


def _polygons(size: int, corners: int, radius: tuple[float, ...], kind: str) -> bytes:
    """As many polygons of so many corners as fit, all around the same circle, whose radius goes up and down."""
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    rings = np.resize(radius, corners)
    points = np.stack([rings * np.cos(angle), rings * np.sin(angle)], axis=1)
    row = " ".join(map(str, [corners, *range(corners)])) + "\n"
    if kind == "off":
        vertices = "".join(f"{x} {y} 0\n" for x, y in points.tolist())
        count = (size - len(vertices)) // len(row)
        return f"OFF\n{corners} {count} 0\n{vertices}{row * count}".encode()
    count = size // (corners + 1)
    header = ply_header("binary_little_endian", f"element vertex {corners}", *XYZ, f"element face {count}",
                        "property list uchar uchar vertex_indices")  # fmt: skip
    body = np.column_stack([points, np.zeros(corners)]).astype("<f4").tobytes()
    return header + body + bytes([corners, *range(corners)]) * count


def _fans_of_all(size: int) -> bytes:
    """Polygons of 255 corners among 65,536 vertices of a plane: two bytes for a triangle."""
    random, count = np.random.default_rng(0), size * 19 // 20 // 511
    x, y = random.integers(-30000, 30000, (2, 65536))
    x[0] = -32000
    vertices = np.stack([x, y, 0 * x], axis=1).astype("<i2")
    angle = np.arctan2(y - y[0], x - x[0])
    rows = np.zeros(count, [("count", "u1"), ("corners", "<u2", 255)])
    chosen = 1 + np.argsort(random.random((count, 1000)), axis=1)[:, :254] + 64 * random.integers(0, 1000, (count, 1))
    rows["count"], rows["corners"][:, 1:] = 255, np.take_along_axis(chosen, np.argsort(angle[chosen], axis=1), axis=1)
    header = ply_header("binary_little_endian", "element vertex 65536", *(f"property short {a}" for a in "xyz"),
                        f"element face {count}", "property list uchar ushort vertex_indices")  # fmt: skip
    return header + vertices.tobytes() + rows.tobytes()


def _deflated_zeros(size: int) -> bytes:
    """What zlib makes of so many zeros, without all of them in memory, which would hide what a reader takes."""
    stream, piece = zlib.compressobj(9), bytes(min(size, 10**6))
    return b"".join(stream.compress(piece) for _ in range(size // len(piece))) + stream.flush()


HEAVY: dict[str, Callable[[int], bytes]] = {
    "grid.off": _as_off,
    "grid.obj": _as_obj,
    "grid.stl": _as_stl,
    "grid.ply": _as_ply,
    "grid.glb": _as_glb,
    "soup.glb": _soup_glb,
    "vertices.off": lambda size: _off_rows(size, b"0 0 0\n", b"3 0 1 2\n", 0.999),
    "faces.off": lambda size: _off_rows(size, b"0 0 0\n", b"3 0 1 2\n", 0.001),
    "both.off": lambda size: _off_rows(size, b"0 0 0\n", b"3 0 1 2\n", 0.4),
    "few_corners.off": lambda size: _off_rows(size, b"0 0 0\n", b"0\n", 0.1),
    "flat_hexagons.off": lambda size: _off_rows(size, b"0 0 0\n", b"6 0 1 2 3 4 5\n", 0.1),
    "hexagons.off": lambda size: _polygons(size, 6, (1,), "off"),
    "concave_hexagons.off": lambda size: _polygons(size, 6, (1, 0.3), "off"),
    "nonagons.off": lambda size: _polygons(size, 9, (1,), "off"),
    "stars.ply": lambda size: _polygons(size, 254, (1, 0.9), "ply"),
    "rings.ply": lambda size: _polygons(size, 255, (1,), "ply"),
    "fans.ply": _fans_of_all,
    "letters.off": lambda size: filled(b"OFF\n9 9 9\n", b"a\n", size),
    "words.off": lambda size: filled(b"OFF\n1 0 0\n", b"ab ", size),
    "one_line.off": lambda size: filled(b"OFF\n", b"1", size),
    "long_integer.off": lambda size: filled(b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 ", b"2", size),
    "blank_lines.off": lambda size: filled(b"OFF\n", b"\n", size),
    "comments.off": lambda size: filled(b"OFF\n", b"#\n", size),
    "wide_vertex.off": lambda size: filled(b"OFF\n1 1 0\n", b"0 ", size, b"\n3 0 0 0\n"),
    "one_polygon.off": lambda size: b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n%d " % (size // 2) + b"0 " * (size // 2),
    "convex.off": lambda size: _polygon(size, "convex"),
    "jagged.off": lambda size: _polygon(size, "jagged"),
    "vertices.obj": lambda size: filled(b"", b"v 0 0 0\n", size, b"f 1 2 3\n"),
    "faces.obj": lambda size: filled(b"v 0 0 0\n", b"f 1 1 1\n", size),
    "back.obj": lambda size: filled(b"v 0 0 0\n", b"f -1/2/3 -1/2/3 -1/2/3\n", size),
    "both.obj": lambda size: filled(b"", b"v 0 0 0\nf 1 1 1\n", size),
    "no_corners.obj": lambda size: filled(b"v 0 0 0\n", b"f\n", size),
    "no_numbers.obj": lambda size: filled(b"", b"v\n", size),
    "letters.obj": lambda size: filled(b"", b"a\n", size),
    "one_polygon.obj": lambda size: filled(b"v 0 0 0\nf", b" 1", size),
    "slashes.obj": lambda size: filled(b"v 0 0 0\nf ", b"/", size),
    "continued.obj": lambda size: filled(b"v 0 0 0\nf 1 1 1", b"\\\n", size),
    "continued_crlf.obj": lambda size: filled(b"v 0 0 0\nf 1 1 1", b"\\\r\n", size),
    "one_line.obj": lambda size: filled(b"v ", b"1", size),
    "blank_lines.obj": lambda size: filled(b"", b"\n", size),
    "separators.obj": lambda size: filled(b"", "\u2028".encode(), size),
    "foreign.obj": lambda size: filled(b"", "\U00010400 ".encode(), size),
    "blank_lines.stl": lambda size: filled(b"solid\n", b"\n", size, b"endsolid\n"),
    "blanks.stl": lambda size: filled(b"solid\n", b" \t", size, b"endsolid\n"),
    "before.stl": lambda size: filled(b"", b"\n", size, b"solid\nendsolid\n"),
    "vertices.stl": lambda size: filled(b"solid\n", b"vertex 0 0 0\n", size // 39 * 39, b"endsolid\n"),
    "vertex_words.stl": lambda size: filled(b"solid\n", b"vertex ", size, b"endsolid\n"),
    "vertex_lines.stl": lambda size: filled(b"solid\n", b"vertex\n\n\n", size, b"endsolid\n"),
    "one_line.stl": lambda size: filled(b"solid\nvertex 0 0 ", b"1", size, b"\nendsolid\n"),
    "zeros.stl": lambda size: bytes(80) + struct.pack("<I", size // 50) + bytes(size // 50 * 50),
    "rows_of_nothing.ply": lambda size: ply_header("ascii", "element vertex 1000000000000"),
    "no_columns.ply": lambda size: ply_header("binary_little_endian", "element vertex 1000000000000", "element face 1"),
    "lists.ply": lambda size: filled(
        ply_header("binary_little_endian", "element vertex 3", *XYZ, f"element face {size}", CORNERS), b"\0", size * 2
    )[:size + 200],
    "lists_of_one.ply": lambda size: filled(
        ply_header("binary_little_endian", "element vertex 3", *XYZ, f"element face {size // 5 - 100}", CORNERS),
        b"\1\0\0\0\0", size,
    ),
    "triangles.ply": lambda size: filled(
        ply_header("binary_little_endian", "element vertex 3", *XYZ, f"element face {size // 13 - 100}", CORNERS),
        b"\3" + bytes(12), size,
    ),
    "byte_triangles.ply": lambda size: filled(
        ply_header("binary_little_endian", "element vertex 3", *XYZ, f"element face {size // 4 - 100}",
                   "property list uchar uchar vertex_indices"),
        b"\3\0\1\2", size,
    ),
    "bytes.ply": lambda size: filled(
        ply_header("binary_little_endian", f"element vertex {size // 3 - 100}", *(f"property uchar {a}" for a in "xyz"),
                   "element face 1", "property list uchar uchar vertex_indices"),
        b"\3\0\1\2", size,
    ),
    "many_columns.ply": lambda size: filled(
        ply_header("binary_little_endian", f"element vertex {size // 40000}",
                   *(f"property char p{k}" for k in range(20000))), b"\0", size,
    ),
    "many_lists.ply": lambda size: filled(
        ply_header("binary_little_endian", "element vertex 3", *XYZ, "element face 1000000",
                   *(f"property list uchar char p{k}" for k in range(40))), b"\0", size,
    ),
    "properties.ply": lambda size: ply_header("ascii", "element vertex 1", *["property char x"] * (size // 17)),
    "header_lines.ply": lambda size: filled(b"ply\n", b"\n", size),
    "elements.ply": lambda size: ply_header("ascii", *["element a 0"] * (size // 12)),
    "text.ply": lambda size: filled(
        ply_header("ascii", f"element vertex {size // 12 - 100}", *XYZ, f"element face {size // 16 - 100}", CORNERS),
        b"0 0 0\n", size // 2,
    ) + b"3 0 1 2\n" * (size // 16),
    "text_lists.ply": lambda size: filled(
        ply_header("ascii", "element vertex 3", *XYZ, f"element face {size // 2 - 100}", CORNERS), b"0 ", size,
    ),
    "text_words.ply": lambda size: filled(
        ply_header("ascii", f"element vertex {size // 6}", *XYZ), b"0 ", size,
    ),
    "length.ply": lambda size: filled(
        ply_header("binary_little_endian", "element face 1", "property list int64 char vertex_indices"), b"\x7f", size,
    ),
    "brackets.gltf": lambda size: b"[" * size,
    "nodes.glb": lambda size: glb(
        json.dumps(gltf_header(nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}])).encode().replace(
            b'"nodes": [{"mesh": 0}]', b'"nodes": [' + b'{"mesh":0},' * (size // 15) + b'{"mesh": 0}]').replace(
            b'"nodes": [0]', b'"nodes": [' + b"0," * (size // 10) + b"0]")
    ),
    "list_of_nodes.glb": lambda size: glb(
        gltf_header(nodes=[{"mesh": 0}] * (size // 22), scenes=[{"nodes": list(range(size // 22))}])
    ),
    "accessors.glb": lambda size: glb(gltf_header(accessors=[{}] * (size // 4))),
    "views.glb": lambda size: glb(gltf_header(bufferViews=[{"buffer": 0, "byteLength": 48}] * (size // 36))),
    "primitives.glb": lambda size: glb(
        gltf_header(meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}] * (size // 48)}])
    ),
    "repeated.glb": lambda size: _gltf_data(
        *_grid(300), nodes=[{"mesh": 0}] * 1000, scenes=[{"nodes": list(range(1000))}]
    ),
    "embedded.gltf": lambda size: json.dumps(
        gltf_header(buffers=[{"byteLength": 48, "uri": "data:application/octet-stream;base64,"
                              + base64.b64encode(bytes(size * 3 // 4)).decode()}])
    ).encode(),
    "zeros.gii.gz": lambda size: gzip.compress(bytes(10**7), 9) * (size // 10_000),
    "blanks.gii": lambda size: filled(b"", b" ", size),
    "elements.gii": lambda size: filled(b"<GIFTI>", b"<a>", size),
    "metadata.gii": lambda size: filled(b"<GIFTI><MetaData>", b"<MD></MD>", size),
    "arrays.gii": lambda size: filled(b"<GIFTI>", b"<DataArray></DataArray>", size),
    "ascii.gii": lambda size: filled(
        b'<GIFTI><DataArray Intent="NIFTI_INTENT_POINTSET" DataType="NIFTI_TYPE_FLOAT32" Dimensionality="2" Dim0="'
        + str(size // 6 - 100).encode() + b'" Dim1="3" Encoding="ASCII"><Data>', b"0 ", size,
        b"</Data></DataArray></GIFTI>"),
    "deflated.gii": lambda size: (
        b'<GIFTI><DataArray Intent="NIFTI_INTENT_POINTSET" DataType="NIFTI_TYPE_FLOAT32" Dimensionality="2" '
        b'Dim0="100000000" Dim1="3" Encoding="GZipBase64Binary" Endian="LittleEndian"><Data>'
        + base64.b64encode(_deflated_zeros(1_200_000_000 // 10_000_000 * size))
        + b"</Data></DataArray></GIFTI>"
    ),
}  # fmt: skip
"""Name of the file: its contents of about so many bytes, which make a reader work as much as they can."""

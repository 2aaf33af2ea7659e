"""Mesh files that need the most time and memory of all files of their size."""

import base64
import gzip
import json
import struct
import zlib
from functools import partial

import numpy as np


def filled(beginning, piece, size, end=b""):
    """Return a beginning, a piece repeated as often as the size allows, and an end."""
    return beginning + piece * ((size - len(beginning) - len(end)) // len(piece)) + end


def ply_header(kind, *lines):
    return "\n".join(["ply", f"format {kind} 1.0", *lines, "end_header", ""]).encode()


XYZ = ("property float x", "property float y", "property float z")
CORNERS = "property list uchar int vertex_indices"
BYTES = "property list uchar uchar vertex_indices"
BINARY = "binary_little_endian"


def _ply(kind, vertices, faces, corners=CORNERS, xyz=XYZ):
    counts = f"element vertex {vertices}", f"element face {faces}"
    return ply_header(kind, counts[0], *xyz, counts[1], corners)


_binary = partial(_ply, BINARY)


def _accessor(view, kind, count, shape="VEC3"):
    return {"bufferView": view, "componentType": kind, "count": count, "type": shape}


def _view(length, offset=0):
    return {"buffer": 0, "byteOffset": offset, "byteLength": length}


def gltf_header(**changes):
    """Return the header of a scene with one triangle in 48 bytes, with changes."""
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [_accessor(0, 5126, 3), _accessor(1, 5125, 3, "SCALAR")],
        "bufferViews": [_view(36), _view(12, 36)],
        "buffers": [{"byteLength": 48}],
    }
    return {name: part for name, part in (header | changes).items() if part is not None}


TRIANGLE = struct.pack("<9f3I", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 2)


def glb(header, data=TRIANGLE):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _grid(side):
    """Return the vertices (side^2, 3) and faces of a bumpy square."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    lower, upper = (a, a + side, a + 1), (a + 1, a + side, a + side + 1)
    faces = np.concatenate([np.stack(half, axis=1) for half in (lower, upper)])
    return np.stack([x, y, np.sin(x) + np.cos(y)], axis=1), faces


def _grid_as_text(size, header, vertex, face, first):
    vertices, faces = _grid(int((size / 42) ** 0.5))
    lines = [header.format(len(vertices), len(faces))]
    lines += [f"{vertex}{x} {y} {z:.2f}\n" for x, y, z in vertices.tolist()]
    lines += [f"{face} {a} {b} {c}\n" for a, b, c in (faces + first).tolist()]
    return "".join(lines).encode()


def _as_stl(size):
    vertices, faces = _grid(int((size / 100) ** 0.5))
    parts = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")]
    record = np.zeros(len(faces), parts)
    record["corners"] = vertices[faces]
    return bytes(80) + struct.pack("<I", len(faces)) + record.tobytes()


def _as_ply(size):
    vertices, faces = _grid(int((size / 38) ** 0.5))
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return _binary(len(vertices), len(faces)) + vertices.astype("<f4").tobytes() + rows.tobytes()


def _gltf_data(vertices, faces, **changes):
    points, corners = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    header = gltf_header(
        accessors=[_accessor(0, 5126, len(vertices)), _accessor(1, 5125, faces.size, "SCALAR")],
        bufferViews=[_view(len(points)), _view(len(corners), len(points))],
        buffers=[{"byteLength": len(points + corners)}],
    )
    return glb(header | changes, points + corners)


def _soup_glb(size):
    corners = np.random.default_rng(0).random((size // 12 // 3 * 3, 3))
    header = gltf_header(
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
        accessors=[_accessor(0, 5126, len(corners))],
        bufferViews=[{"buffer": 0, "byteLength": 12 * len(corners)}],
    )
    return glb(header, corners.astype("<f4").tobytes())


def _off_rows(size, face, share):
    vertex = b"0 0 0\n"
    vertices, faces = int(size * share / len(vertex)), int(size * (1 - share) / len(face))
    return b"OFF\n%d %d 0\n" % (vertices, faces) + vertex * vertices + face * faces


def _polygon(size, kind):
    """Return one polygon with as many corners as fit into the size: a circle or a random star."""
    count = size // 52
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    radius = 1 + (0 if kind == "convex" else 0.5) * np.random.default_rng(0).random(count)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    lines = ["OFF", f"{count} 1 0", *(f"{x!r} {y!r} 0" for x, y in points.tolist()), f"{count} "]
    return ("\n".join(lines) + " ".join(map(str, range(count)))).encode()


def _polygons(size, corners, radius, kind):
    """Return as many polygons as the size allows, all around one circle with alternating radii."""
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    rings = np.resize(radius, corners)
    points = np.stack([rings * np.cos(angle), rings * np.sin(angle)], axis=1)
    row = " ".join(map(str, [corners, *range(corners)])) + "\n"
    if kind == "off":
        vertices = "".join(f"{x} {y} 0\n" for x, y in points.tolist())
        count = (size - len(vertices)) // len(row)
        return f"OFF\n{corners} {count} 0\n{vertices}{row * count}".encode()
    count = size // (corners + 1)
    header = _binary(corners, count, BYTES)
    body = np.column_stack([points, np.zeros(corners)]).astype("<f4").tobytes()
    return header + body + bytes([corners, *range(corners)]) * count


def _fans_of_all(size):
    """Return polygons of 255 corners among 65,536 vertices of a plane, two bytes a triangle."""
    random, count = np.random.default_rng(0), size * 19 // 20 // 511
    x, y = random.integers(-30000, 30000, (2, 65536))
    x[0] = -32000
    vertices = np.stack([x, y, 0 * x], axis=1).astype("<i2")
    angle = np.arctan2(y - y[0], x - x[0])
    rows = np.zeros(count, [("count", "u1"), ("corners", "<u2", 255)])
    chosen = 1 + np.argsort(random.random((count, 1000)), axis=1)[:, :254]
    chosen += 64 * random.integers(0, 1000, (count, 1))
    around = np.argsort(angle[chosen], axis=1)
    rows["count"], rows["corners"][:, 1:] = 255, np.take_along_axis(chosen, around, axis=1)
    shorts = [f"property short {a}" for a in "xyz"]
    header = _binary(65536, count, "property list uchar ushort vertex_indices", shorts)
    return header + vertices.tobytes() + rows.tobytes()


def _deflated_zeros(size):
    """Return zeros compressed by zlib, without creating all of them in memory."""
    stream, piece = zlib.compressobj(9), bytes(min(size, 10**6))
    return b"".join(stream.compress(piece) for _ in range(size // len(piece))) + stream.flush()


_OFF, _SOLID, _END = b"OFF\n", b"solid\n", b"endsolid\n"
_TRIANGLE = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n"
_REPEATED = {
    "letters.off": (b"OFF\n9 9 9\n", b"a\n", b""),
    "words.off": (b"OFF\n1 0 0\n", b"ab ", b""),
    "one_line.off": (_OFF, b"1", b""),
    "long_integer.off": (_TRIANGLE + b"3 0 1 ", b"2", b""),
    "blank_lines.off": (_OFF, b"\n", b""),
    "comments.off": (_OFF, b"#\n", b""),
    "wide_vertex.off": (b"OFF\n1 1 0\n", b"0 ", b"\n3 0 0 0\n"),
    "vertices.obj": (b"", b"v 0 0 0\n", b"f 1 2 3\n"),
    "faces.obj": (b"v 0 0 0\n", b"f 1 1 1\n", b""),
    "back.obj": (b"v 0 0 0\n", b"f -1/2/3 -1/2/3 -1/2/3\n", b""),
    "both.obj": (b"", b"v 0 0 0\nf 1 1 1\n", b""),
    "no_corners.obj": (b"v 0 0 0\n", b"f\n", b""),
    "no_numbers.obj": (b"", b"v\n", b""),
    "letters.obj": (b"", b"a\n", b""),
    "one_polygon.obj": (b"v 0 0 0\nf", b" 1", b""),
    "slashes.obj": (b"v 0 0 0\nf ", b"/", b""),
    "continued.obj": (b"v 0 0 0\nf 1 1 1", b"\\\n", b""),
    "continued_crlf.obj": (b"v 0 0 0\nf 1 1 1", b"\\\r\n", b""),
    "one_line.obj": (b"v ", b"1", b""),
    "blank_lines.obj": (b"", b"\n", b""),
    "separators.obj": (b"", "\u2028".encode(), b""),
    "foreign.obj": (b"", "\U00010400 ".encode(), b""),
    "blank_lines.stl": (_SOLID, b"\n", _END),
    "blanks.stl": (_SOLID, b" \t", _END),
    "before.stl": (b"", b"\n", _SOLID + _END),
    "vertices.stl": (_SOLID, b"vertex 0 0 0\n" * 3, _END),
    "vertex_words.stl": (_SOLID, b"vertex ", _END),
    "vertex_lines.stl": (_SOLID, b"vertex\n\n\n", _END),
    "one_line.stl": (_SOLID + b"vertex 0 0 ", b"1", b"\n" + _END),
    "header_lines.ply": (b"ply\n", b"\n", b""),
    "blanks.gii": (b"", b" ", b""),
    "elements.gii": (b"<GIFTI>", b"<a>", b""),
    "metadata.gii": (b"<GIFTI><MetaData>", b"<MD></MD>", b""),
    "arrays.gii": (b"<GIFTI>", b"<DataArray></DataArray>", b""),
    "labels.gii": (b"<GIFTI>", b'<Label Key="1">a</Label>', b""),
    "one_label.gii": (b'<GIFTI><Label Key="1">', b"a", b"</Label></GIFTI>"),
    "lines.white": (b"\xff\xff\xfe", b"a", b""),
}
"""Beginning, repeated piece, and end of each file."""
_POINTS = (
    b'<GIFTI><DataArray Intent="NIFTI_INTENT_POINTSET" DataType="NIFTI_TYPE_FLOAT32" '
    b'Dimensionality="2" Dim0="%d" Dim1="3" %s><Data>'
)
_POINTS_END = b"</Data></DataArray></GIFTI>"
_HUGE = "element vertex 1000000000000"


_LISTS = "\n".join(f"property list uchar char p{k}" for k in range(40))
_COLUMNS = [f"property char p{k}" for k in range(20000)]
_SHORT_XYZ = [f"property uchar {a}" for a in "xyz"]
_LONG_LIST = ("element face 1", "property list int64 char vertex_indices")
_ROWS = {
    "lists_of_one.ply": (lambda size: _binary(3, size // 5 - 100), b"\1\0\0\0\0"),
    "triangles.ply": (lambda size: _binary(3, size // 13 - 100), b"\3" + bytes(12)),
    "byte_triangles.ply": (lambda size: _binary(3, size // 4 - 100, BYTES), b"\3\0\1\2"),
    "bytes.ply": (lambda size: _binary(size // 3 - 100, 1, BYTES, _SHORT_XYZ), b"\3\0\1\2"),
    "many_columns.ply": (
        lambda size: ply_header(BINARY, f"element vertex {size // 40000}", *_COLUMNS),
        b"\0",
    ),
    "many_lists.ply": (lambda size: _binary(3, 10**6, _LISTS), b"\0"),
    "text_lists.ply": (lambda size: _ply("ascii", 3, size // 2 - 100), b"0 "),
    "text_words.ply": (
        lambda size: ply_header("ascii", f"element vertex {size // 6}", *XYZ),
        b"0 ",
    ),
    "length.ply": (lambda size: ply_header(BINARY, *_LONG_LIST), b"\x7f"),
}
"""Function of the size that returns the header, and the repeated row."""


def _text_ply(size):
    header = _ply("ascii", size // 12 - 100, size // 16 - 100)
    return filled(header, b"0 0 0\n", size // 2) + b"3 0 1 2\n" * (size // 16)


def _many_nodes(size):
    """Return a glTF file with as many nodes as fit; the scene repeats the first node."""
    text = json.dumps(gltf_header(nodes=["NODES"], scenes=[{"nodes": ["SCENE"]}]))
    nodes = '{"mesh":0},' * (size // 15) + '{"mesh": 0}'
    text = text.replace('"NODES"', nodes).replace('"SCENE"', "0," * (size // 10) + "0")
    return glb(text.encode())


def _embedded(size):
    data = base64.b64encode(bytes(size * 3 // 4)).decode()
    uri = f"data:application/octet-stream;base64,{data}"
    return json.dumps(gltf_header(buffers=[{"byteLength": 48, "uri": uri}])).encode()


def _primitives(size):
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    return glb(gltf_header(meshes=[{"primitives": [primitive] * (size // 48)}]))


def _gltf_nodes(count):
    return {"nodes": [{"mesh": 0}] * count, "scenes": [{"nodes": list(range(count))}]}


def _deflated_gifti(size):
    how = b'Encoding="GZipBase64Binary" Endian="LittleEndian"'
    zeros = base64.b64encode(_deflated_zeros(1_200_000_000 // 10_000_000 * size))
    return _POINTS % (10**8, how) + zeros + _POINTS_END


def _ascii_gifti(size):
    return filled(_POINTS % (size // 6 - 100, b'Encoding="ASCII"'), b"0 ", size, _POINTS_END)


HEAVY = {
    "grid.off": lambda size: _grid_as_text(size, "OFF\n{} {} 0\n", "", "3", 0),
    "grid.obj": lambda size: _grid_as_text(size, "", "v ", "f", 1),
    "grid.stl": _as_stl,
    "grid.ply": _as_ply,
    "grid.glb": lambda size: _gltf_data(*_grid(int((size / 36) ** 0.5))),
    "soup.glb": _soup_glb,
    "vertices.off": lambda size: _off_rows(size, b"3 0 1 2\n", 0.999),
    "faces.off": lambda size: _off_rows(size, b"3 0 1 2\n", 0.001),
    "both.off": lambda size: _off_rows(size, b"3 0 1 2\n", 0.4),
    "few_corners.off": lambda size: _off_rows(size, b"0\n", 0.1),
    "flat_hexagons.off": lambda size: _off_rows(size, b"6 0 1 2 3 4 5\n", 0.1),
    "hexagons.off": lambda size: _polygons(size, 6, (1,), "off"),
    "concave_hexagons.off": lambda size: _polygons(size, 6, (1, 0.3), "off"),
    "nonagons.off": lambda size: _polygons(size, 9, (1,), "off"),
    "stars.ply": lambda size: _polygons(size, 254, (1, 0.9), "ply"),
    "rings.ply": lambda size: _polygons(size, 255, (1,), "ply"),
    "fans.ply": _fans_of_all,
    **{
        name: lambda size, parts=parts: filled(parts[0], parts[1], size, parts[2])
        for name, parts in _REPEATED.items()
    },
    "one_polygon.off": lambda size: _TRIANGLE + b"%d " % (size // 2) + b"0 " * (size // 2),
    "convex.off": lambda size: _polygon(size, "convex"),
    "jagged.off": lambda size: _polygon(size, "jagged"),
    "zeros.stl": lambda size: bytes(80) + struct.pack("<I", size // 50) + bytes(size // 50 * 50),
    **{
        name: lambda size, header=header, row=row: filled(header(size), row, size)
        for name, (header, row) in _ROWS.items()
    },
    "zeros.white": lambda size: filled(
        b"\xff\xff\xfe\n\n" + struct.pack(">ii", size // 24, size // 24), b"\0", size + 2
    ),
    "lists.ply": lambda size: filled(_binary(3, size), b"\0", size * 2)[: size + 200],
    "rows_of_nothing.ply": lambda size: ply_header("ascii", _HUGE),
    "no_columns.ply": lambda size: ply_header(BINARY, _HUGE, "element face 1"),
    "properties.ply": lambda size: ply_header(
        "ascii", "element vertex 1", *["property char x"] * (size // 17)
    ),
    "elements.ply": lambda size: ply_header("ascii", *["element a 0"] * (size // 12)),
    "text.ply": _text_ply,
    "brackets.gltf": lambda size: b"[" * size,
    "nodes.glb": _many_nodes,
    "list_of_nodes.glb": lambda size: glb(gltf_header(**_gltf_nodes(size // 22))),
    "accessors.glb": lambda size: glb(gltf_header(accessors=[{}] * (size // 4))),
    "zeros.gii.gz": lambda size: gzip.compress(bytes(10**7), 9) * (size // 10_000),
    "views.glb": lambda size: glb(
        gltf_header(bufferViews=[{"buffer": 0, "byteLength": 48}] * (size // 36))
    ),
    "primitives.glb": _primitives,
    "repeated.glb": lambda size: _gltf_data(*_grid(300), **_gltf_nodes(1000)),
    "embedded.gltf": _embedded,
    "ascii.gii": _ascii_gifti,
    "deflated.gii": _deflated_gifti,
}
"""Functions of the size that return the contents of files which are expensive to read."""

"""Writers of textured surfaces: OBJ with MTL and PNG files, and binary glTF.

The writers of trimesh are not used. In OBJ files, trimesh renumbers the vertices and writes eight
digits. In glTF files it writes no sampler, so that mipmaps would mix neighbouring parts of the
image.
"""

import json
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ResultError
from abfm.io.atomic import write_atomically, write_file
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray
from abfm.wording import counted

TEXTURED_ENDINGS = (".obj", ".glb")  # endings of names that `write_textured` supports
_HEADER = b"glTF\x02\0\0\0"
_JSON = b"JSON"
_BINARY = b"BIN\0"
# numbers of glTF: the linear filter and the wrapping of samplers, and types of components
_FILTER = 9729
_WRAP = 33071
_FLOAT_COMPONENT = 5126
_UNSIGNED_COMPONENT = 5125
_POINT_TARGET = 34962
_INDEX_TARGET = 34963
_CHUNK_LINES = 1 << 16  # lines of text written together


def textured_files(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Return the files that `write_textured` writes; ResultError if the name is not supported."""
    main_file = Path(path)
    ending = main_file.suffix.lower()
    if ending not in TEXTURED_ENDINGS:
        raise ResultError(
            f"cannot write {path}: the name must end with {' or '.join(TEXTURED_ENDINGS)}"
        )
    if ending == ".glb":
        return (main_file,)
    name = main_file.stem
    if not name.isprintable() or "#" in name or name != " ".join(name.split()):
        raise ResultError(
            f"cannot write {path}: the name of an OBJ file with a texture must not have #, line "
            "breaks or consecutive blanks. Choose another name"
        )
    return main_file, main_file.with_suffix(".mtl"), main_file.with_suffix(".png")


def write_textured(
    path: str | os.PathLike[str],
    mesh: TriangleMesh,
    coordinates: ArrayLike,
    png: bytes,
    alpha_mode: str = "OPAQUE",
) -> None:
    """Write a textured surface atomically, as ``.obj`` or ``.glb``.

    An ``.obj`` file is written together with ``.mtl`` and ``.png`` files of the same name; a
    ``.glb`` file has all data. `abfm.load_mesh` reads the same vertices and faces. A ``.glb`` file
    has single precision, and separate vertices for each face.

    Parameters
    ----------
    coordinates : (F, 3, 2) array
        Texture coordinates of the corners of each face: (0, 0) is the lower left corner of the
        image, and (1, 1) the upper right one.
    png : bytes
        The image as a PNG file.
    alpha_mode : str
        Use of the opacity, as in glTF: OPAQUE, MASK or BLEND.

    Raises
    ------
    ResultError
        If a shape does not fit, vertices would coincide in single precision, or files cannot be
        written.
    """
    files = textured_files(path)
    places = real_numbers(coordinates, "coordinates", ResultError)
    if places.shape != (len(mesh.faces), 3, 2):
        raise ResultError(
            f"coordinates have shape {places.shape}; expected ({len(mesh.faces)}, 3, 2)"
        )
    if len(files) == 1:
        write_file(files[0], _glb(mesh, places, png, alpha_mode))
        return
    obj, mtl, image = files
    # files that are referred to are replaced first
    with (
        write_atomically(obj) as obj_file,
        write_atomically(mtl) as mtl_file,
        write_atomically(image) as image_file,
    ):
        image_file.write_bytes(png)
        material = f"newmtl texture\nKd 1 1 1\nd 1\nillum 1\nmap_Kd {image.name}\n"
        mtl_file.write_bytes(material.encode())
        _write_obj(obj_file, mesh, places, mtl.name)


def _write_obj(file: Path, mesh: TriangleMesh, places: FloatArray, materials: str) -> None:
    """Write an OBJ file in full double precision, with texture coordinates for each corner."""
    numbers = np.arange(1, 3 * len(mesh.faces) + 1).reshape(-1, 3)
    corners = np.stack([mesh.faces + 1, numbers], axis=2).reshape(-1, 6)
    with file.open("w", encoding="utf-8", newline="\n") as text:
        text.write(f"mtllib {materials}\n")
        for form, rows in (
            ("v %.17g %.17g %.17g\n", mesh.vertices),
            ("vt %.9g %.9g\n", places.reshape(-1, 2)),
            ("usemtl texture\n", np.zeros((1, 0))),
            ("f %d/%d %d/%d %d/%d\n", corners),
        ):
            for start in range(0, len(rows), _CHUNK_LINES):
                some = rows[start : start + _CHUNK_LINES]
                text.write((form * len(some)) % tuple(some.ravel().tolist()))


def _glb(mesh: TriangleMesh, places: FloatArray, png: bytes, alpha_mode: str) -> bytes:
    """Return the bytes of a .glb file, with a separate vertex for each corner of a face.

    The corners are sorted by their vertex of the mesh. A reader that merges vertices by position
    therefore numbers them as the mesh does.
    """
    points = mesh.vertices.astype("<f4")
    lost = len(np.unique(mesh.vertices, axis=0)) - len(np.unique(points, axis=0))
    if lost or not np.isfinite(points).all():
        raise ResultError(
            "cannot write .glb: in its single precision, "
            f"{counted(lost, 'vertex', 'vertices')} would coincide with others. Write .obj, or "
            "scale the surface and move it to the origin"
        )
    order = np.argsort(mesh.faces, axis=None, kind="stable")
    corners = np.empty(len(order), dtype="<u4")
    corners[order] = np.arange(len(order))
    positions = points[mesh.faces.ravel()[order]]
    down = (places.reshape(-1, 2) * [1, -1] + [0, 1]).astype("<f4")[order]
    parts = [part.tobytes() for part in (positions, down, corners)] + [png]
    starts, binary = [], b""
    for part in parts:
        starts.append(len(binary))
        binary += part + b"\0" * (-len(part) % 4)
    targets = [{"target": _POINT_TARGET}, {"target": _POINT_TARGET}, {"target": _INDEX_TARGET}, {}]
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(part)} | target
        for start, part, target in zip(starts, parts, targets, strict=True)
    ]
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    accessors = [
        _accessor(0, _FLOAT_COMPONENT, len(order), "VEC3") | bounds,
        _accessor(1, _FLOAT_COMPONENT, len(order), "VEC2"),
        _accessor(2, _UNSIGNED_COMPONENT, len(order), "SCALAR"),
    ]
    surface = {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1}
    header = {
        "asset": {"version": "2.0", "generator": "abfm"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
                ]
            }
        ],
        "materials": [
            {"pbrMetallicRoughness": surface, "alphaMode": alpha_mode, "doubleSided": True}
        ],
        "textures": [{"sampler": 0, "source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        # without mipmaps, which would mix neighbouring parts of the image
        "samplers": [{"magFilter": _FILTER, "minFilter": _FILTER, "wrapS": _WRAP, "wrapT": _WRAP}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(header, separators=(",", ":")).encode("ascii")
    chunks = b""
    for kind, content in ((_JSON, text + b" " * (-len(text) % 4)), (_BINARY, binary)):
        chunks += struct.pack("<I", len(content)) + kind + content
    return _HEADER + struct.pack("<I", 12 + len(chunks)) + chunks


def _accessor(view: int, kind: int, count: int, shape: str) -> dict[str, Any]:
    return {"bufferView": view, "componentType": kind, "count": count, "type": shape}

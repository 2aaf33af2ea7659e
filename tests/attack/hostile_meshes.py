"""Mesh files made to hurt: small ones that say they are huge, that expand, nest or repeat
without end.
"""

from __future__ import annotations

import base64
import gzip
import json
import zlib
from random import Random
from typing import Any

from tests.attack.heavy_meshes import gltf_header
from tests.attack.specimens import WHOLE, Specimen
from tests.mesh_writers import obj_text, off_text, ply_bytes

_MANY = (10**5, 10**6, 10**7, 10**8, 10**9, 2**31 - 1, 2**32, 2**53, 2**62, 2**63, 10**30)
_OFF = off_text(WHOLE.vertices, WHOLE.faces)
_OBJ = obj_text(WHOLE.vertices, WHOLE.faces)
_PLY, _BIG_PLY = (
    ply_bytes(WHOLE.vertices, WHOLE.faces.tolist(), kind) for kind in ("ascii", "binary_big_endian")
)


def _mesh(name: str, content: str | bytes) -> Specimen:
    return Specimen(name, "mesh", content.encode() if isinstance(content, str) else content)


def counts(random: Random) -> Specimen:
    """Headers that announce far more than follows."""
    many = random.choice(_MANY)
    kind = random.choice(("off", "ply", "big.ply", "stl", "surf.gii"))
    if kind == "off":
        return _mesh("a.off", _OFF.replace("42 80", f"{random.choice((42, many))} {many}", 1))
    if kind == "stl":
        return _mesh("a.stl", bytes(80) + (many % 2**32).to_bytes(4, "little") + bytes(50 * 80))
    if kind == "surf.gii":
        return gifti(random, dims=(many, random.choice((3, many))))
    ply = _BIG_PLY if kind == "big.ply" else _PLY
    counted = random.choice((b"face 80", b"vertex 42"))
    return _mesh("a.ply", ply.replace(counted, b"face %d" % many, 1))


def gifti(random: Random, dims: tuple[int, int] = (42, 3)) -> Specimen:
    """Bombs in GIFTI: compressed zeros, entities of entities, nesting, files beside that are
    devices.
    """
    zeros = zlib.compress(bytes(random.choice((10**6, 10**8, 10**9))), 9)
    encoding, extra, data = "GZipBase64Binary", "", base64.b64encode(zeros).decode()
    act = random.randrange(5)
    if act == 0:
        extra = "<!DOCTYPE GIFTI [<!ENTITY a0 'aaaaaaaaaa'>"
        extra += "".join(f"<!ENTITY a{k} '{f'&a{k - 1};' * 10}'>" for k in range(1, 10)) + "]>"
        encoding, data = "ASCII", "&a9;"
    elif act == 1:
        encoding, data = "ASCII", "<x>" * random.choice((10**4, 10**6))
    elif act == 2:
        encoding, data = "ExternalFileBinary", ""
    elif act == 3:
        encoding, data = "ASCII", "1 " * random.choice((126, 10**6)) + "1e" + "9" * 10**5
    attributes = (
        f'Encoding="{encoding}" DataType="NIFTI_TYPE_FLOAT32" '
        'ExternalFileName="/dev/zero" '
        'ExternalFileOffset="0"'
    )
    attributes += f' Dimensionality="2" Dim0="{dims[0]}" Dim1="{dims[1]}" Endian="LittleEndian"'
    arrays = "".join(
        f'<DataArray Intent="NIFTI_INTENT_{intent}" {attributes}><Data>{data}</Data></DataArray>'
        for intent in ("POINTSET", "TRIANGLE")
    )
    text = (
        f'<?xml version="1.0"?>{extra}<GIFTI Version="1.0" NumberOfDataArrays="2">{arrays}</GIFTI>'
    ).encode()
    return Specimen("a.surf.gii", random.choice(("mesh", "values")), text)


def gzip_bomb(random: Random) -> Specimen:
    """A gzip file of nothing but one byte, some gigabytes of it; also in several members, or
    within another.
    """
    piece = gzip.compress(random.choice((b"\0", b" ", b"<")) * (1 << 26), mtime=0)
    content = piece * random.choice((1, 30, 120))
    if random.random() < 0.3:
        content = gzip.compress(content, mtime=0)
    return Specimen("a.gii.gz", random.choice(("mesh", "values", "map")), content[: 10 << 20])


def gltf(random: Random) -> Specimen:
    """Accessors without buffers, nodes in circles, NaN matrices, nesting, buffers that are
    devices.
    """
    many: dict[str, Any] = {"componentType": 5126, "type": "VEC3", "count": random.choice(_MANY)}
    accessor, counts = many, random.choice((3, *_MANY))
    indices = {"componentType": 5125, "type": "SCALAR", "count": counts}
    tree: dict[str, Any] = gltf_header(
        accessors=[accessor, indices], bufferViews=None, buffers=None
    )
    act = random.randrange(7)
    if act == 0:
        tree["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [random.choice((0, 1))]}]
    elif act == 1:
        depth = random.choice((100, 2000, 20000))
        tree["nodes"] = [{"children": [k + 1]} for k in range(depth)] + [{"mesh": 0}]
    elif act == 2:  # doubled at each level: 2**40 copies
        tree["nodes"] = [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}]
    elif act == 3:
        tree["nodes"] = [{"mesh": 0, "matrix": [float("nan")] * 16}]
    elif act == 4:
        places = ("/dev/zero", "file:///dev/zero", "http://localhost:9/x", "../../../../dev/zero")
        tree["buffers"] = [{"byteLength": 1 << 40, "uri": random.choice(places)}]
        tree["bufferViews"] = [{"buffer": 0, "byteLength": 1 << 40}]
        accessor["bufferView"] = 0
    elif act == 5:
        view = {"bufferView": 0}
        accessor["sparse"] = {"count": 10**9, "indices": view, "values": view}
    text = json.dumps(tree)
    if act == 6:
        text = '{"asset":' * 10**5 + "0" + "}" * 10**5 if random.random() < 0.5 else "[" * 10**6
    return _mesh("a.gltf", text)


def long_lines(random: Random) -> Specimen:
    """Blank lines, comments, words and numbers by the million."""
    name = random.choice(("a.off", "a.obj", "a.ply", "a.stl"))
    text = {"a.off": _OFF, "a.obj": _OBJ, "a.ply": _PLY.decode()}.get(
        name, "solid a\n facet normal 0 0 1\n  outer loop\n"
    )
    filler = random.choice(
        (
            *("\n", "# x\n", "comment x\n", " ", "\t\n", "0 ", "v 0 0 0\n", "f 1 2 3\n", "x", "9"),
            *("facet\n", "\\\n", "\r"),
        )
    )
    piece = filler * (random.choice((10**5, 10**6, 9 << 20)) // len(filler))
    place = random.choice((0, 4, text.find("\n") + 1, len(text) // 2, len(text)))
    return _mesh(name, text[:place] + piece + text[place:])


def huge_polygons(random: Random) -> Specimen:
    """Faces of very many corners, or with the same ones."""
    n = random.choice((10**3, 10**5, 10**6))
    corners = random.choice((lambda k: k % 42, lambda k: 0, lambda k: k))
    name = random.choice(("a.obj", "a.off"))
    if name == "a.obj":
        return _mesh(name, _OBJ + "f " + " ".join(str(corners(k) + 1) for k in range(n)) + "\n")
    row = " ".join([str(n), *(str(corners(k)) for k in range(n))])
    return _mesh(name, _OFF.replace("42 80", "42 81", 1) + row + "\n")


def ply_headers(random: Random) -> Specimen:
    """PLY headers with very many elements or properties, and lists of lists."""
    n = random.choice((100, 10**4, 3 * 10**5))
    act = random.randrange(4)
    more = (
        "".join(f"property float p{k}\n" for k in range(n)),
        "property list uint float q\n" * min(n, 10**4),
        "".join(
            f"element e{k} {random.choice((0, 1, 10**9))}\nproperty float x\n" for k in range(n)
        ),
        "".join(f"element e{k} 1000000000\n" for k in range(min(n, 10**4))),
    )[act]
    place = b"element face" if act < 2 else b"end_header"
    return _mesh("a.ply", _PLY.replace(place, more.encode() + place, 1))


def extremes(random: Random) -> Specimen:
    """Coordinates at the ends of what numbers can be."""
    scale = random.choice((1e-320, 1e-300, 1e-160, 1e-30, 1e30, 1e150, 1e160, 1e300, 1.7e308))
    shift = random.choice((0.0, 1e10, 1e16, 1e300))
    vertices = WHOLE.vertices * scale + shift
    return _mesh(
        *random.choice(
            (("a.off", off_text(vertices, WHOLE.faces)), ("a.obj", obj_text(vertices, WHOLE.faces)))
        )
    )


MAKERS = (counts, gifti, gzip_bomb, gltf, long_lines, huge_polygons, ply_headers, extremes)

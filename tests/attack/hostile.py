"""Files, and what is none, made to hurt: bombs, lies, nesting, references, devices, broken meshes.

`HOSTILE` is a table: a name, and a function of a `random.Random` that returns a specimen.
"""

import base64
import gzip
import io
import json
import os
import pickle
import struct
import zipfile
import zlib
from dataclasses import replace
from functools import partial

import numpy as np

from tests.attack.specimens import COUNT, MESH, WHOLE, Specimen, X, specimens
from tests.attack.victim import LARGEST
from tests.core.mesh.heavy_meshes import HEAVY, gltf_header
from tests.core.reading.vtk_files import vtk_bytes
from tests.mesh_writers import WRITERS, obj_text, off_text, ply_bytes
from tests.shapes import icosphere, moebius_arrays, open_cylinder, square, tetrahedron, torus

_MANY = (10**5, 10**8, 2**31 - 1, 2**32, 2**62, 2**63, 10**30)
_DEVICES = ("/dev/zero", "/dev/urandom", "/dev/null", "/dev/tty")
_OFF, _OBJ = off_text(WHOLE.vertices, WHOLE.faces), obj_text(WHOLE.vertices, WHOLE.faces)
_PLY = ply_bytes(WHOLE.vertices, WHOLE.faces.tolist(), "ascii")
_POINTS = (
    '<DataArray Intent="NIFTI_INTENT_POINTSET" DataType="NIFTI_TYPE_FLOAT32" Endian="LittleEndian" '
    'Dimensionality="2" Dim0="{}" Dim1="3" Encoding="{}" {}><Data>{}</Data></DataArray>'
)
_VTK = '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><FieldData>{}</FieldData>{}</VTKFile>'


def hostile(chance):
    """Return a hostile specimen, and what it is called."""
    name = chance.choice(list(HOSTILE))
    return HOSTILE[name](chance), name


def _mesh(name, content):
    return Specimen(name, "mesh", (content.encode() if isinstance(content, str) else content))


def _counts(chance):
    """Announce far more than follows."""
    many = chance.choice(_MANY)
    name = chance.choice(("a.off", "a.ply", "a.stl", "a.surf.gii", "a.mgh", "a-lh.stc"))
    if name == "a.off":
        return _mesh(name, _OFF.replace("42 80", f"{chance.choice((42, many))} {many}", 1))
    if name == "a.stl":
        return _mesh(name, bytes(80) + (many % 2**32).to_bytes(4, "little") + bytes(50 * 80))
    if name == "a.mgh":
        sizes = [chance.choice((0, 1, 2**31 - 1)) for _ in range(4)]
        return Specimen(name, "frames", struct.pack(">7i256x", 1, *sizes, 3, 0))
    if name == "a-lh.stc":
        return Specimen(name, "frames", struct.pack(">ffI", 0, 1, many % 2**32) + bytes(99))
    if name == "a.surf.gii":
        return _gifti(_POINTS.format(many, "ASCII", "", "1 2 3"))
    return _mesh(name, _PLY.replace(b"face 80", b"face %d" % many, 1))


def _gifti(arrays, begin="", chance=None):
    text = f'<?xml version="1.0"?>{begin}<GIFTI Version="1.0">{arrays}</GIFTI>'
    door = chance.choice(("mesh", "values", "frames", "labels")) if chance else "mesh"
    return Specimen("a.surf.gii", door, text.encode())


def _entities(chance):
    """Have entities of entities, or an attribute with a long default value."""
    if chance.random() < 0.5:
        dtd = "<!ENTITY a0 'aaaaaaaaaa'>"
        dtd += "".join(f"<!ENTITY a{k} '{f'&a{k - 1};' * 10}'>" for k in range(1, 10))
        arrays = _POINTS.format(42, "ASCII", "", "&a9;")
        return _gifti(arrays, f"<!DOCTYPE GIFTI [{dtd}]>", chance)
    long = "x" * chance.choice((99, 4 << 20))
    if chance.random() < 0.5:
        dtd = f'<!DOCTYPE GIFTI [<!ATTLIST MD a CDATA "{long}">]>'
        return _gifti("<MD/>" * 50_000, dtd, chance)
    dtd = f'<!DOCTYPE VTKFile [<!ATTLIST DataArray a CDATA "{long}">]>'
    return Specimen("a_1.vtu", "frames", (dtd + _VTK.format("<DataArray/>" * 20_000, "")).encode())


def _xml(chance):
    """Nest, have a number of very many digits, or an encoding that nobody knows."""
    head = f'<?xml version="1.0" encoding="{chance.choice(("foo", "utf-7", "latin-9"))}"?>'
    numbers = "1 " * 10**6 + "1e" + "9" * 10**5
    found = (
        *(
            _gifti("<x>" * 10**6),
            _gifti(_POINTS.format(42, "ASCII", "", numbers)),
            _gifti("", head),
        ),
        Specimen("a.pvd", "frames", f"{head}<VTKFile/>".encode()),
    )
    return chance.choice(found)


def _repeated_arrays(chance):
    """Name the same appended bytes, or the same file, very often."""
    points = MESH.on_file(MESH.vertices, 9.0)
    values = {"u": MESH.on_file(X, 0.0)}
    whole = vtk_bytes(points, values, "base64", time=1.0)
    if chance.random() < 0.5:
        begin, end = whole.index(b"<FieldData>"), whole.index(b"</FieldData>")
        field, other = whole[begin + 11 : end], vtk_bytes(points, values, "base64", time=2.0)
        filler = b"\n" * (4 << 20)
        content = whole.replace(field, field * 30_000).replace(
            b"</AppendedData>", filler + b"</AppendedData>"
        )
        return Specimen("a_1.vtu", "frames", content, {"a_2.vtu": other})
    count = chance.choice((10, 1000, 150_000))
    rows = "".join(f'<DataSet timestep="{k}" file="w.vtu"/>' for k in range(count))
    listed = f'<VTKFile type="Collection"><Collection>{rows}</Collection></VTKFile>'
    return Specimen("a.pvd", "frames", listed.encode(), {"w.vtu": whole})


def _packed(chance):
    """Hold gigabytes of one byte in a few kilobytes."""
    zeros = zlib.compress(bytes(chance.choice((10**6, 10**9))), 9)
    if chance.random() < 0.3:
        data = base64.b64encode(zeros).decode()
        return _gifti(_POINTS.format(42, "GZipBase64Binary", "", data), chance=chance)
    content = gzip.compress(chance.choice((b"\0", b" ", b"<")) * (1 << 26), mtime=0)
    content *= chance.choice((1, 30, 120))
    name = chance.choice(("a.gii.gz", "a.obj.gz", "a.mgz"))
    return Specimen(name, chance.choice(("mesh", "values", "map", "frames")), content[:LARGEST])


def _references(chance):
    """Name files elsewhere on the machine."""
    place = chance.choice(("/etc/passwd", "../../../../etc/passwd", "/dev/zero", "http://x/y"))
    more = f'ExternalFileName="{place}" ExternalFileOffset="0"'
    row = f'<VTKFile type="Collection"><Collection><DataSet timestep="1" file="{place}"/>'
    series = json.dumps({"files": [{"name": place, "time": 1}]})
    tree = gltf_header(buffers=[{"byteLength": 48, "uri": place}])
    found = (
        _gifti(_POINTS.format(14, "ExternalFileBinary", more, ""), chance=chance),
        Specimen("a.pvd", "frames", f"{row}</Collection></VTKFile>".encode()),
        Specimen("a.vtu.series", "frames", series.encode()),
        _mesh("a.gltf", json.dumps(tree)),
    )
    return chance.choice(found)


def _gltf(chance):
    """Have nodes in circles or doubled, NaN matrices, nesting."""
    depth = chance.choice((100, 20_000))
    nodes = (
        [{"mesh": 0, "children": [1]}, {"children": [0]}],
        [{"children": [k + 1]} for k in range(depth)] + [{"mesh": 0}],
        [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}],
        [{"mesh": 0, "matrix": [float("nan")] * 16}],
    )
    text = json.dumps(gltf_header(nodes=chance.choice(nodes)))
    return _mesh("a.gltf", chance.choice((text, "[" * 10**6, '{"a":' * 10**5 + "0" + "}" * 10**5)))


def _lines(chance):
    """Repeat a line, a word or a digit by the million."""
    name = chance.choice(("a.off", "a.obj", "a.ply", "a.csv", "a.txt", "a.vts"))
    text = {"a.off": _OFF, "a.obj": _OBJ, "a.ply": _PLY.decode()}.get(name, "1\n" * COUNT)
    filler = chance.choice(
        ("\n", "# x\n", " ", "0 ", "f 1 2 3\n", "x", "9", '"', "1,", "\0", "\\\n")
    )
    piece = filler * (chance.choice((10**5, 10**6, 9 << 20)) // len(filler))
    at = chance.choice((0, 4, text.find("\n") + 1, len(text)))
    door = (
        "mesh"
        if name in ("a.off", "a.obj", "a.ply")
        else chance.choice(("values", "map", "frames"))
    )
    return Specimen(name, door, (text[:at] + piece + text[at:]).encode())


def _npy(chance):
    """Have a header that lies, holds objects, nests, or is a program."""
    size, kind = (
        chance.choice((2**62, 10**12, 10**9, -1, 0)),
        chance.choice(("<f8", "|O", "<U999999999", "|b1", "<c16")),
    )
    header = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': ({size},), }}"
    header = chance.choice((header, "(" * 9000, "{" * 9000, "9" * 60_000, "{'a':" * 9000))
    if chance.random() < 0.2:
        header = header.replace("}", "'x': __import__('os').abort(), }")
    body = pickle.dumps([1, 2]) if kind == "|O" else bytes(8 * COUNT)
    content = b"\x93NUMPY\2\0" + struct.pack("<I", len(header)) + header.encode() + body
    return Specimen("a.npy", chance.choice(("values", "map", "frames")), content)


def _zips(chance):
    """Expand, overlap or repeat members of results and projects."""
    name = chance.choice(("result.npz", "plain.abfm", "rich.abfm"))
    specimen, file = specimens()[name], io.BytesIO(specimens()[name].content)
    act = chance.randrange(3)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        if act == 0:
            member = archive.open(chance.choice(("x.npy", "known/9.npy")), "w", force_zip64=True)
            with member:
                for _ in range(8):
                    member.write(bytes(10**8))
        elif act == 1:
            for k in range(30_000):
                archive.writestr(zipfile.ZipInfo(f"{k}.npy"), b"")
    data = file.getvalue()
    if act == 2:  # all members at the place of the first one
        places = [k for k in range(len(data)) if data[k : k + 4] == b"PK\1\2"]
        changed = bytearray(data)
        for place in places:
            changed[place + 42 : place + 46] = data[places[0] + 42 : places[0] + 46]
        data = bytes(changed)
    return Specimen(name, specimen.door, data[:LARGEST])


def _results(chance):
    """Have counts, parameters and words that no result has."""
    with np.load(io.BytesIO(specimens()["result.npz"].content)) as result:
        arrays = dict(result)
    changes = (
        {"file_vertex_count": np.array(chance.choice((10**7, 10**12, -1)))},
        {"velocity": arrays["velocity"] * chance.choice((1e10, 1e300))},
        {"parameters": np.array(chance.choice(('{"tau": 1e308}', "{}", "[" * 10**5, "null")))},
        {"format_version": chance.choice((np.arange(9), np.array("1"), np.array(2**62)))},
        {"weights": arrays["weights"] * chance.choice((-1.0, 1e300, 0.0))},
        {"verdict": np.array(["x" * 10**5, "a\nb", "\0", ""])},
        {"stop_reason": np.array(chance.choice(("x" * 10**6, "a\nb\nc", "\x1b[31m")))},
    )
    file = io.BytesIO()
    np.savez(file, **arrays | chance.choice(changes))
    return Specimen("result.npz", "result", file.getvalue())


def _words_of_batch(chance):
    """Have control characters, formulas and foreign paths in a folder of results."""
    names = [n for n, s in specimens().items() if s.door == "batch" and n.endswith(".json")]
    specimen = specimens()[chance.choice(names)]
    tree = json.loads(specimen.content)
    place = tree["rows"][0] if "rows" in tree else tree
    key = chance.choice([key for key, value in place.items() if isinstance(value, str)])
    place[key] = chance.choice(("\x1b[31mred", "=1+1", "../x", "/tmp/x", "\ud800"))
    return replace(specimen, content=json.dumps(tree).encode())


def _texts(chance):
    """Nest or repeat JSON, or functions as text."""
    n = chance.choice((50, 10**5))
    texts = ("[" * n, '{"a":' * n, "9" * n, '{"theme": ["dark"], "ui_scale": 1e999}')
    specs = (
        *("permuted:mirror(" * n + "coordinate:x" + ")" * n, "expression:" + "(" * n + "x"),
        *("expression:x" + "**x" * n, "expression:9**9**9**9", "expression:'a'*10**9"),
        *(" + ".join(["coordinate:x"] * n), "expression:().__class__", "hks:time=1e-320"),
        *("eigenfunction:" + "9" * 20, "file:/dev/zero", "gaussian:vertex=1,width=1e-162"),
    )
    name, chosen = chance.choice(
        (("recent.json", texts), ("preferences.json", texts), ("a.spec", specs))
    )
    door = name.removesuffix(".json").removeprefix("a.")
    return Specimen(name, door, chance.choice(chosen).encode())


def _special(chance):
    """Put a folder, a pipe, a device or a link in a circle in the place of a file."""
    door, suffix = chance.choice(
        (
            ("mesh", ".off"),
            ("values", ".npy"),
            ("result", ".npz"),
            ("project", ".abfm"),
            ("frames", ".pvd"),
        )
    )
    place = chance.choice(
        (
            os.mkdir,
            os.mkfifo,
            partial(os.symlink, chance.choice(_DEVICES)),
            partial(os.symlink, f"a{suffix}"),
        )
    )

    def put(path):
        path.unlink()
        place(path)

    return Specimen(f"a{suffix}", door, b"", place=put)


_SHAPES = (icosphere(0), torus(6, 5), square(4), open_cylinder(6, 2), tetrahedron())
_COORDINATES = (np.nan, np.inf, 1e308, -1e308, 5e-324, 1e200, 1e-60, 0.0)


def _broken(chance):
    """Make a mesh that is no surface, or hardly one."""
    shape = chance.choice(_SHAPES)
    V, F = shape.vertices.copy(), shape.faces.copy()
    for _ in range(chance.choice((1, 1, 2, 3))):
        face, vertex = chance.randrange(len(F)), chance.randrange(len(V))
        V, F = chance.choice(_BREAKS)(chance, V, F, face, vertex)
    name = chance.choice(("a.obj", "a.off", "ascii.ply", "little.ply"))
    with np.errstate(all="ignore"):
        return _mesh(name, WRITERS[name][0](V, F.clip(-(2**31), 2**31 - 1)))


def _index(chance):
    """Name a vertex that is not there."""
    name, F = chance.choice(list(WRITERS)), WHOLE.faces.copy()
    F[chance.randrange(len(F)), 2] = (
        42 if name.endswith((".glb", ".off")) else chance.choice((42, 99))
    )
    return Specimen(name, "mesh", WRITERS[name][0](WHOLE.vertices, F), must_be_refused=True)


def _with(array, place, value):
    changed = array.copy()
    changed[place] = value
    return changed


def _size(chance, V, F, *_):
    return V * chance.choice((1e-70, 1e-9, 1e9, 1e70)) + chance.choice((0, 1e9, 1e16)), F


_BREAKS = (
    lambda c, V, F, f, v: (_with(V, (v, c.randrange(3)), c.choice(_COORDINATES)), F),
    lambda c, V, F, f, v: (V, _with(F, (f, 0), c.choice((-1, -(2**31), 2**31 - 1, len(V))))),
    lambda c, V, F, f, v: (V, _with(F, (f, 0), F[f, 1])),
    lambda c, V, F, f, v: (V, np.concatenate([F, F[f : f + 1]])),
    lambda c, V, F, f, v: (V, _with(F, f, F[f, ::-1])),
    lambda c, V, F, f, v: (V, F[: c.randint(1, 2)]),
    lambda c, V, F, f, v: (np.vstack([V, V[:1] + 5]), np.vstack([F, [*F[f, :2], len(V)]])),
    lambda c, V, F, f, v: (_with(V, v, V[c.randrange(len(V))]), F),
    lambda c, V, F, f, v: (V, _with(F, v == F, c.randrange(len(V)))),
    lambda c, V, F, f, v: (np.vstack([V, V + 5]), np.vstack([F, F + len(V)])),
    lambda c, V, F, f, v: (V * _with(np.ones(3), c.randrange(3), c.choice((0.0, 1e-13))), F),
    lambda c, V, F, f, v: moebius_arrays(c.randint(3, 20)),
    lambda c, V, F, f, v: (V, np.concatenate([F, F[:, ::-1]])),
    _size,
)
"""What may be wrong with vertices and faces, each at a face and a vertex."""


def _heavy(chance):
    name, size = chance.choice(list(HEAVY)), chance.choice((10**4, 10**5, 9 * 10**6))
    return _mesh(name, HEAVY[name](size)[:LARGEST])


HOSTILE = {
    "counts": _counts,
    "entities": _entities,
    "XML": _xml,
    "repeated arrays": _repeated_arrays,
    "packed": _packed,
    "references": _references,
    "glTF": _gltf,
    "lines": _lines,
    "NumPy header": _npy,
    "zips": _zips,
    "results": _results,
    "texts": _texts,
    "words of a batch": _words_of_batch,
    "special files": _special,
    "broken mesh": _broken,
    "index": _index,
    "heavy mesh": _heavy,
}
"""Makers of specimens by what is wrong with these."""

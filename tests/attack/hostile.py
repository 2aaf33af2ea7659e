"""Hostile files: decompression bombs, nesting, references, long lines, broken and large meshes.

`HOSTILE` is a table of names and functions of a `random.Random` that return a specimen. Wrong
counts and indices, devices and texts are in tables of `tests/core/reading` and `tests/core/mesh`.
"""

import base64
import gzip
import io
import json
import zipfile
from dataclasses import replace

import numpy as np

from tests.attack.specimens import COUNT, MESH, SPHERE, Specimen, X, specimens
from tests.attack.victim import LARGEST
from tests.core.mesh.heavy_meshes import HEAVY
from tests.core.reading.hostile import bomb
from tests.core.reading.vtk_files import vtk_bytes
from tests.mesh_writers import WRITERS, obj_text, off_text
from tests.shapes import icosphere, moebius_arrays, open_cylinder, square, tetrahedron, torus

_OFF, _OBJ = off_text(SPHERE.vertices, SPHERE.faces), obj_text(SPHERE.vertices, SPHERE.faces)
_POINTS = (
    '<DataArray Intent="NIFTI_INTENT_POINTSET" DataType="NIFTI_TYPE_FLOAT32" Endian="LittleEndian" '
    'Dimensionality="2" Dim0="{}" Dim1="3" Encoding="{}" {}><Data>{}</Data></DataArray>'
)
_VTK = '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><FieldData>{}</FieldData>{}</VTKFile>'


def hostile(chance):
    name = chance.choice(list(HOSTILE))
    specimen = HOSTILE[name](chance)
    return replace(specimen, content=specimen.content[:LARGEST]), name


def _mesh(name, content):
    return Specimen(name, "mesh", (content.encode() if isinstance(content, str) else content))


def _gifti(arrays, begin="", chance=None):
    text = f'<?xml version="1.0"?>{begin}<GIFTI Version="1.0">{arrays}</GIFTI>'
    reader = chance.choice(("mesh", "values", "frames", "labels")) if chance else "mesh"
    return Specimen("a.surf.gii", reader, text.encode())


def _xml(chance):
    """Return XML with deep nesting, recursive entities, long default values, unknown encodings."""
    dtd = "<!ENTITY a0 'aaaaaaaaaa'>"
    dtd += "".join(f"<!ENTITY a{k} '{f'&a{k - 1};' * 10}'>" for k in range(1, 10))
    long = f'CDATA "{"x" * chance.choice((99, 4 << 20))}">]>'
    head = f'<?xml version="1.0" encoding="{chance.choice(("foo", "utf-7", "latin-9"))}"?>'
    numbers = "1 " * 10**6 + "1e" + "9" * 10**5
    arrays = _VTK.format("<DataArray/>" * 20_000, "")
    vtu = f"<!DOCTYPE VTKFile [<!ATTLIST DataArray a {long}{arrays}"
    return chance.choice(
        (
            _gifti(_POINTS.format(42, "ASCII", "", "&a9;"), f"<!DOCTYPE GIFTI [{dtd}]>", chance),
            _gifti("<MD/>" * 50_000, f"<!DOCTYPE GIFTI [<!ATTLIST MD a {long}", chance),
            Specimen("a_1.vtu", "frames", vtu.encode()),
            _gifti("<x>" * 10**6),
            _gifti(_POINTS.format(42, "ASCII", "", numbers)),
            _gifti("", head),
            Specimen("a.pvd", "frames", f"{head}<VTKFile/>".encode()),
        )
    )


def _repeated_arrays(chance):
    """Return a file that refers to the same appended bytes, or the same file, very often."""
    points, values = MESH.on_file(MESH.vertices, 9.0), {"u": MESH.on_file(X, 0.0)}
    first, other = (vtk_bytes(points, values, "base64", time=time) for time in (1.0, 2.0))
    field = first[first.index(b"<FieldData>") + 11 : first.index(b"</FieldData>")]
    end = b"</AppendedData>"
    many = first.replace(field, field * 15_000).replace(end, b"\n" * (4 << 20) + end)
    rows = '<DataSet timestep="1" file="w.vtu"/>' * chance.choice((10, 1000, 150_000))
    listed = f'<VTKFile type="Collection"><Collection>{rows}</Collection></VTKFile>'
    collection = Specimen("a.pvd", "frames", listed.encode(), {"w.vtu": first})
    return chance.choice((Specimen("a_1.vtu", "frames", many, {"a_2.vtu": other}), collection))


def _packed(chance):
    """Return a file of a few kilobytes that expands to gigabytes of one byte."""
    if chance.random() < 0.3:
        data = base64.b64encode(bomb(chance.choice((1 << 20, 1 << 30)))).decode()
        return _gifti(_POINTS.format(42, "GZipBase64Binary", "", data), chance=chance)
    content = gzip.compress(chance.choice((b"\0", b" ", b"<")) * (1 << 26), mtime=0)
    content *= chance.choice((1, 30, 120))
    name = chance.choice(("a.gii.gz", "a.obj.gz", "a.mgz"))
    return Specimen(name, chance.choice(("mesh", "values", "map", "frames")), content)


def _lines(chance):
    """Return a file in which a line, a word or a digit is repeated a million times."""
    name = chance.choice(("a.off", "a.obj", "a.csv", "a.txt", "a.vts"))
    text = {"a.off": _OFF, "a.obj": _OBJ}.get(name, "1\n" * COUNT)
    reader = "mesh" if name in ("a.off", "a.obj") else chance.choice(("values", "map", "frames"))
    fillers = ("\n", "# x\n", " ", "0 ", "f 1 2 3\n", "x", "9", '"', "1,", "\0", "\\\n")
    filler = chance.choice(fillers)
    piece = filler * (chance.choice((10**5, 10**6, 9 << 20)) // len(filler))
    at = chance.choice((0, 4, text.find("\n") + 1, len(text)))
    return Specimen(name, reader, (text[:at] + piece + text[at:]).encode())


def _zips(chance):
    """Return a result or project whose members expand, overlap or repeat."""
    specimen = specimens()[chance.choice(("result.npz", "plain.abfm", "rich.abfm"))]
    file, act = io.BytesIO(specimen.content), chance.randrange(3)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        if act == 0:
            name = chance.choice(("x.npy", "known/9.npy"))
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(bytes(1 << 29))
        elif act == 1:
            for k in range(30_000):
                archive.writestr(zipfile.ZipInfo(f"{k}.npy"), b"")
        else:
            archive.comment = b"written anew"
            for member in archive.filelist:
                member.header_offset = archive.filelist[0].header_offset
    return replace(specimen, content=file.getvalue())


def _words_of_batch(chance):
    """Return a folder of results with control characters, formulas and foreign paths."""
    names = [n for n, s in specimens().items() if s.reader == "batch" and n.endswith(".json")]
    specimen = specimens()[chance.choice(names)]
    tree = json.loads(specimen.content)
    place = tree["rows"][0] if "rows" in tree else tree
    key = chance.choice([key for key, value in place.items() if isinstance(value, str)])
    place[key] = chance.choice(("\x1b[31mred", "=1+1", "../x", "/tmp/x", "\ud800"))
    return replace(specimen, content=json.dumps(tree).encode())


_SHAPES = (icosphere(0), torus(6, 5), square(4), open_cylinder(6, 2), tetrahedron())
_COORDINATES = (np.nan, np.inf, 1e308, -1e308, 5e-324, 1e200, 1e-60, 0.0)


def _broken(chance):
    """Return a mesh that is not a surface, or degenerate."""
    shape = chance.choice(_SHAPES)
    V, F = shape.vertices.copy(), shape.faces.copy()
    for _ in range(chance.choice((1, 1, 2, 3))):
        face, vertex = chance.randrange(len(F)), chance.randrange(len(V))
        V, F = chance.choice(_BREAKS)(chance, V, F, face, vertex)
    name = chance.choice(("a.obj", "a.off", "ascii.ply", "little.ply"))
    with np.errstate(all="ignore"):
        return _mesh(name, WRITERS[name][0](V, F.clip(-(2**31), 2**31 - 1)))


def _with(array, place, value):
    changed = array.copy()
    changed[place] = value
    return changed


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
    lambda c, V, F, f, v: (V * c.choice((1e-70, 1e-9, 1e9, 1e70)) + c.choice((0, 1e9, 1e16)), F),
)
"""Faults of vertices and faces, each at a face and a vertex."""


def _heavy(chance):
    name = chance.choice(list(HEAVY))
    return _mesh(name, HEAVY[name](chance.choice((10**4, 10**5, 9 * 10**6))))


HOSTILE = {
    "XML": _xml,
    "repeated arrays": _repeated_arrays,
    "packed": _packed,
    "lines": _lines,
    "zips": _zips,
    "words of a batch": _words_of_batch,
    "broken mesh": _broken,
    "heavy mesh": _heavy,
}
"""Functions that make specimens, by the kind of fault."""

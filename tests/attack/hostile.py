"""Files, and what is none, made to hurt who opens them."""

import base64
import gzip
import io
import json
import os
import pickle
import socket
import struct
import threading
import time
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from random import Random

import numpy as np

from tests.attack.heavy_meshes import gltf_header
from tests.attack.specimens import COUNT, WHOLE, Specimen, specimens
from tests.attack.victim import run_victim
from tests.mesh_writers import obj_text, off_text, ply_bytes

_MANY = (10**5, 10**6, 10**7, 10**8, 10**9, 2**31 - 1, 2**32, 2**53, 2**62, 2**63, 10**30)
_OFF = off_text(WHOLE.vertices, WHOLE.faces)
_OBJ = obj_text(WHOLE.vertices, WHOLE.faces)
_PLY, _BIG_PLY = (
    ply_bytes(WHOLE.vertices, WHOLE.faces.tolist(), kind) for kind in ("ascii", "binary_big_endian")
)
_HEADERS = (
    *("(" * 9000, "{" * 9000, "[" * 60000, "9" * 60000, "-" * 60000, "'" * 99, "\n" * 60000),
    "{'a':" * 9000,
)
_METHODS = (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
_DEVICES = "/dev/zero", "/dev/urandom", "/dev/null", "/dev/full", "/dev/tty"


def hostile(seed):
    """What the seed puts in the way, and its name; seeds in a row take all kinds in turn."""
    maker = _MAKERS[seed % len(_MAKERS)]
    specimen = maker(Random(seed))
    return specimen, f"{maker.__name__} as {specimen.name}"


# Mesh files: small ones that say they are huge, that expand, nest or repeat without end


def _mesh(name, content):
    return Specimen(name, "mesh", content.encode() if isinstance(content, str) else content)


def counts(random):
    """Headers that announce far more than follows."""
    many = random.choice(_MANY)
    kind = random.choice(("off", "ply", "big.ply", "stl", "surf.gii"))
    if kind == "off":
        return _mesh("a.off", _OFF.replace("42 80", f"{random.choice((42, many))} {many}", 1))
    if kind == "stl":
        return _mesh("a.stl", bytes(80) + (many % 2**32).to_bytes(4, "little") + bytes(50 * 80))
    if kind == "surf.gii":
        return gifti(random, dims=(many, random.choice((3, many))))
    counted = random.choice((b"face 80", b"vertex 42"))
    ply = _BIG_PLY if kind == "big.ply" else _PLY
    return _mesh("a.ply", ply.replace(counted, b"face %d" % many, 1))


def gifti(random, dims=(42, 3)):
    """Bombs in GIFTI: compressed zeros, entities of entities, nesting, devices beside."""
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
        f'Encoding="{encoding}" DataType="NIFTI_TYPE_FLOAT32" ExternalFileName="/dev/zero" '
        'ExternalFileOffset="0"'
        f' Dimensionality="2" Dim0="{dims[0]}" Dim1="{dims[1]}" Endian="LittleEndian"'
    )
    arrays = "".join(
        f'<DataArray Intent="NIFTI_INTENT_{intent}" {attributes}><Data>{data}</Data></DataArray>'
        for intent in ("POINTSET", "TRIANGLE")
    )
    text = (
        f'<?xml version="1.0"?>{extra}<GIFTI Version="1.0" NumberOfDataArrays="2">{arrays}</GIFTI>'
    )
    return Specimen("a.surf.gii", random.choice(("mesh", "values")), text.encode())


def gzip_bomb(random):
    """Some gigabytes of one byte; also in several members, or within another."""
    piece = gzip.compress(random.choice((b"\0", b" ", b"<")) * (1 << 26), mtime=0)
    content = piece * random.choice((1, 30, 120))
    if random.random() < 0.3:
        content = gzip.compress(content, mtime=0)
    return Specimen("a.gii.gz", random.choice(("mesh", "values", "map")), content[: 10 << 20])


def gltf(random):
    """Accessors without buffers, nodes in circles, NaN matrices, nesting, devices as buffers."""
    accessor = {"componentType": 5126, "type": "VEC3", "count": random.choice(_MANY)}
    indices = {"componentType": 5125, "type": "SCALAR", "count": random.choice((3, *_MANY))}
    tree = gltf_header(accessors=[accessor, indices], bufferViews=None, buffers=None)
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


def long_lines(random):
    """Blank lines, comments, words and numbers by the million."""
    name = random.choice(("a.off", "a.obj", "a.ply", "a.stl"))
    solid = "solid a\n facet normal 0 0 1\n  outer loop\n"
    text = {"a.off": _OFF, "a.obj": _OBJ, "a.ply": _PLY.decode()}.get(name, solid)
    fillers = "\n", "# x\n", "comment x\n", " ", "\t\n", "0 ", "v 0 0 0\n", "f 1 2 3\n", "x", "9"
    filler = random.choice((*fillers, "facet\n", "\\\n", "\r"))
    piece = filler * (random.choice((10**5, 10**6, 9 << 20)) // len(filler))
    place = random.choice((0, 4, text.find("\n") + 1, len(text) // 2, len(text)))
    return _mesh(name, text[:place] + piece + text[place:])


def huge_polygons(random):
    """Faces of very many corners, or with the same ones."""
    n = random.choice((10**3, 10**5, 10**6))
    corners = random.choice((lambda k: k % 42, lambda k: 0, lambda k: k))
    name = random.choice(("a.obj", "a.off"))
    if name == "a.obj":
        return _mesh(name, _OBJ + "f " + " ".join(str(corners(k) + 1) for k in range(n)) + "\n")
    row = " ".join([str(n), *(str(corners(k)) for k in range(n))])
    return _mesh(name, _OFF.replace("42 80", "42 81", 1) + row + "\n")


def ply_headers(random):
    """PLY headers with very many elements or properties, and lists of lists."""
    n = random.choice((100, 10**4, 3 * 10**5))
    act = random.randrange(4)
    sizes = [random.choice((0, 1, 10**9)) for _ in range(n)]
    more = (
        "".join(f"property float p{k}\n" for k in range(n)),
        "property list uint float q\n" * min(n, 10**4),
        "".join(f"element e{k} {size}\nproperty float x\n" for k, size in enumerate(sizes)),
        "".join(f"element e{k} 1000000000\n" for k in range(min(n, 10**4))),
    )[act]
    place = b"element face" if act < 2 else b"end_header"
    return _mesh("a.ply", _PLY.replace(place, more.encode() + place, 1))


def extremes(random):
    """Coordinates at the ends of what numbers can be."""
    scale = random.choice((1e-320, 1e-300, 1e-160, 1e-30, 1e30, 1e150, 1e160, 1e300, 1.7e308))
    vertices = WHOLE.vertices * scale + random.choice((0.0, 1e10, 1e16, 1e300))
    name, write = random.choice((("a.off", off_text), ("a.obj", obj_text)))
    return _mesh(name, write(vertices, WHOLE.faces))


# Values, results, projects and functions


def _npy(header, body=b"", version=b"\1\0"):
    length = struct.pack("<H" if version == b"\1\0" else "<I", len(header))
    return b"\x93NUMPY" + version + length + header.encode("latin-1", "replace") + body


def npy(random):
    """Arrays that say they are huge, hold objects, or whose header is a program."""
    a, b, c = (random.choice((2**62, 2**63, 10**12, 10**9, -1, 0)) for _ in range(3))
    shape = random.choice((f"({a},)", f"({b}, {c})", "(1,) * 10**9"))
    kind = random.choice(("<f8", "|O", "<U999999999", "|V999999999", "|b1", "<c16"))
    header = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}"
    act = random.randrange(6)
    if act == 0:
        header = random.choice(_HEADERS)
    elif act == 1:
        header = header.replace("}", "'x': __import__('os').abort(), }")
    body = pickle.dumps([1, 2]) if kind == "|O" else bytes(8 * COUNT)
    version = b"\2\0"
    if len(header) < 60000:
        version = random.choice((b"\1\0", b"\1\0", b"\2\0", b"\3\0"))
    return Specimen("a.npy", random.choice(("values", "map")), _npy(header, body, version))


def tables(random):
    """Text with very long lines, very many columns or numbers of very many digits."""
    n = random.choice((10**4, 2 * 10**5, 5 * 10**6))
    contents = (
        *(b'"' + b"x" * n + b'",1\n1,2\n', b"1," * n + b"1\n", b"1 " * n, b"9" * n + b"\n"),
        *(b"0." + b"3" * n + b"\n" + b"1\n" * 42, b"\n" * n, b"#\n" * n, b"1\n" * n),
        *(b"nan\n" * COUNT, b'"' * n, b"1" + b"\0" * n, ("1\n" * n).encode("utf-16")),
        *(b"\xff" * n, b"a,b\n" + b"1,2,3\n" * n),
    )
    content = random.choice(contents)
    door = random.choice(("values", "map"))
    name = random.choice(("a.csv", "a.txt", "a.vts", "a.sym.vts"))
    return Specimen(name, door, content[: 9 << 20])


def bombs(random):
    """Results and projects whose members expand, overlap, are very many, or unknown and large."""
    name = random.choice(("result.npz", "plain.abfm", "rich.abfm"))
    specimen, method = specimens()[name], random.choice(_METHODS)
    file = io.BytesIO(specimen.content)
    act = random.randrange(4)
    with zipfile.ZipFile(file, "a", method) as archive:
        if act == 0:
            big = np.zeros(random.choice((10**6, 10**8)), dtype=np.uint8)
            new = random.choice(("x.npy", "known/9.npy", "x.json"))
            with archive.open(new, "w", force_zip64=True) as member:
                for _ in range(random.choice((1, 8))):
                    member.write(big)
        elif act == 1:
            for k in range(random.choice((10**3, 3 * 10**4))):
                archive.writestr(zipfile.ZipInfo(f"{k}.npy"), b"")
        elif act == 2:
            archive.comment = b"PK\5\6" * 10**4
        else:
            header = "{" + " " * 9 * 10**6 + "}"
            archive.writestr(zipfile.ZipInfo("format_version.npy"), _npy(header, version=b"\2\0"))
    return Specimen(name, specimen.door, file.getvalue()[: 10 << 20])


def quine(random):
    """A zip all of whose entries are one large member."""
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000,), }"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(zipfile.ZipInfo("0.npy"), _npy(header, bytes(8 * 10**6)))
    data = file.getvalue()
    begin, end = data.find(b"PK\1\2"), data.find(b"PK\5\6")
    record, count = data[begin:end], random.choice((100, 5000, 60000))
    records = b"".join(record[:-5] + f"{k % 10**1}.npy".encode() for k in range(count))
    tail = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, count, count, len(records), begin, 0)
    door = random.choice(("result", "project"))
    return Specimen("a.npz" if door == "result" else "a.abfm", door, data[:begin] + records + tail)


def numbers(random):
    """Results with counts and parameters beyond everything."""
    with np.load(io.BytesIO(specimens()["result.npz"].content)) as result:
        arrays = dict(result)
    act = random.randrange(7)
    if act == 0:
        count = random.choice((10**7, 10**8, 10**12, 4 * 10**18, -1))
        arrays["file_vertex_count"] = np.array(count)
    elif act == 1:
        arrays["velocity"] = arrays["velocity"] * random.choice((1e10, 1e100, 1e300))
    elif act == 2:
        long = "[" * 10**5, '{"tau": ' + "9" * 10**5 + "}"
        arrays["parameters"] = np.array(random.choice(('{"tau": 1e308}', "{}", *long, "null")))
    elif act == 3:
        versions = (np.arange(10**5), *map(np.array, ("1", 2**62, [], 1.0)))
        arrays["format_version"] = random.choice(versions)
    elif act == 4:
        arrays["mask" if random.random() < 0.5 else "weights"] *= random.choice((-1.0, 1e300, 0.0))
    elif act == 5:
        arrays["verdict"] = np.array(["x" * 10**5, "a\nb", "\0", ""])
    else:
        arrays["stop_reason"] = np.array(random.choice(("x" * 10**6, "a\nb\nc", "", "\udc80")))
    file = io.BytesIO()
    np.savez(file, **arrays)
    return Specimen("result.npz", "result", file.getvalue())


def json_texts(random):
    """JSON that nests, repeats or holds numbers without end."""
    texts = (
        *("[" * 10**6, "[" * 10**5 + "]" * 10**5, '{"a":' * 10**5 + "1" + "}" * 10**5),
        *("9" * 10**6, "1e" + "9" * 10**5, "[" + "0," * 10**6 + "0]"),
        json.dumps(["/x" * 10**4] * 100),
        *(json.dumps(["\0", "\udc80", "a\nb", 5, None, {}, []]), '"' + "x" * 9 * 10**6 + '"'),
        '{"format_version": ' + "9" * 5000 + "}",
        '{"theme": ["dark"], "ui_scale": 1e999, "follow": 3}',
        *('{"theme": {}, "ui_scale": NaN}', "", "\ufeff{}"),
    )
    text = random.choice(texts).encode("utf-8", "surrogatepass")
    name = random.choice(("recent.json", "preferences.json", "rich.abfm"))
    if name != "rich.abfm":
        return Specimen(name, name.removesuffix(".json"), text)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        member = random.choice(("project.json", "origin.json"))
        archive.writestr(zipfile.ZipInfo(member), text)
        if member == "origin.json":
            with zipfile.ZipFile(io.BytesIO(specimens()[name].content)) as good:
                for info in good.infolist():
                    archive.writestr(info, good.read(info))
    return Specimen(name, "project", file.getvalue())


def specs(random):
    """Functions as text that nest, repeat, or ask for numbers without end."""
    n = random.choice((50, 1000, 10**5))
    index = random.choice(("99999999999999999999", "41", "42", "43", "1000000", "-1"))
    pairs = random.choice(("1", "42", "1000000000", "99999999999999999999"))
    time = random.choice(("1e-320", "1e308", "0", "-1", "nan"))
    width = random.choice(("1e-320", "1e-162", "1e308", "1e-9", "0"))
    texts = (
        "permuted:mirror(" * n + "coordinate:x" + ")" * n,
        "expression:" + "(" * n + "x" + ")" * n,
        *("expression:" + "-" * n + "x", "expression:x" + "+x" * n, "expression:x" + "**x" * n),
        " + ".join(["coordinate:x"] * n),
        *("expression:9**9**9**9", "expression:9**9**9"),
        "expression:10**" + "9" * min(n, 1000),
        *("expression:'a'*10**9", "expression:[x]*10**9", "expression:[x for y in z]"),
        "expression:().__class__.__base__.__subclasses__()",
        *("expression:open('/etc/passwd')", "expression:where(x>0,1/0,x)"),
        *("expression:exp(exp(exp(9+x)))", "expression:1<<10**9", "expression:" + "9" * n),
        *(f"eigenfunction:{index}", f"wks:energy=1,eigenpairs={pairs}", f"hks:time={time}"),
        *(f"gaussian:vertex=3,width={width}", "gaussian:x=1e308,y=-1e308,z=1e308"),
        "gaussian:x=1e-320,y=0,z=0,height=1e308 + gaussian:x=0,y=0,z=0,height=1e308",
        *("geodesic:vertex=" + "1" * n, "indicator:vertex=3,radius=1e308"),
        "indicator:axis=x,above=-1e308",
        "gaussian:vertex=3,height=1e308 + gaussian:vertex=3,height=1e308",
        *("gaussian:vertex=3,height=1e-320", 'file:"' + "a/" * n + 'x.csv"'),
        *('file:"/dev/zero.csv"', 'permuted:"' + "x" * n + '.txt"(coordinate:x)'),
        *("☃" * n, "\n" * n, "a:" * n, "," * n, '"' * n),
    )
    return Specimen("a.spec", "spec", random.choice(texts).encode())


# What is no file, or does not stay what it was. Files that may not be read are not tried: tests may
# run as root, who reads them all.


def _any(random, place, but=("spec",)):
    known = specimens()
    specimen = known[random.choice([name for name, one in known.items() if one.door not in but])]
    return Specimen(specimen.name, specimen.door, specimen.content, specimen.beside, place)


def _instead(random, make):
    def place(path):
        path.unlink()
        make(path)

    return _any(random, place)


def devices(random):
    """A link to a device."""
    device = random.choice([d for d in _DEVICES if Path(d).exists()])
    return _instead(random, lambda path: path.symlink_to(device))


def pipes(random):
    """A pipe that nobody writes to, a socket that nobody listens to."""

    def bind(path):
        with socket.socket(socket.AF_UNIX) as made:
            folder = os.open(path.parent, os.O_RDONLY)  # names of sockets may not be long
            try:
                made.bind(f"/proc/self/fd/{folder}/{path.name}")
            finally:
                os.close(folder)

    return _instead(random, random.choice((os.mkfifo, os.mkfifo, bind)))


def links(random):
    """A link to nowhere, to itself, to the folder; a folder of the file's name."""

    def folder_with_something(path):
        path.mkdir()
        (path / "x").touch()

    makers = (
        lambda path: path.symlink_to("nowhere"),
        lambda path: path.symlink_to(path.name),
        lambda path: path.symlink_to("."),
        *(Path.mkdir, folder_with_something),
    )
    return _instead(random, random.choice(makers))


def moving(random):
    """A file that vanishes, shrinks or grows while it is read."""
    pause, act = random.random() * 0.01, random.randrange(4)

    def move(path):
        time.sleep(pause)
        with suppress(OSError):  # the next trial has begun
            size = path.stat().st_size
            if act == 0:
                path.unlink()
            elif act == 1:
                os.truncate(path, size // 2)
            else:
                with path.open("ab") as file:
                    for _ in range(1 if act == 2 else 100):
                        file.write(bytes(10**5))

    return _any(
        random,
        lambda path: threading.Thread(target=move, args=(path,)).start(),
        ("spec", "recent", "preferences"),  # the latter are written, too
    )


def holes(random):
    """A file of many gigabytes of which nothing is on the disk."""
    size = random.choice((2**31, 2**33, 2**40))
    return _any(random, lambda path: os.truncate(path, size))


_MAKERS = (
    *(counts, gifti, gzip_bomb, gltf, long_lines, huge_polygons, ply_headers, extremes),
    *(npy, tables, bombs, quine, numbers, json_texts, specs, specs),
    *(devices, pipes, links, moving, holes),
)

if __name__ == "__main__":
    run_victim("hostile", "hostile", __doc__)

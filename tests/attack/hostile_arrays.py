"""Values, maps, results, projects and functions made to hurt."""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
from random import Random

import numpy as np

from tests.attack.specimens import COUNT, Door, Specimen, specimens


def _npy(header: str, body: bytes = b"", version: bytes = b"\1\0") -> bytes:
    length = struct.pack("<H" if version == b"\1\0" else "<I", len(header))
    return b"\x93NUMPY" + version + length + header.encode("latin-1", "replace") + body


def npy(random: Random) -> Specimen:
    """Arrays that say they are huge, hold objects, or whose header is a program."""
    sizes = (2**62, 2**63, 10**12, 10**9, -1, 0)
    shape = random.choice(
        (
            f"({random.choice(sizes)},)",
            f"({random.choice(sizes)}, {random.choice(sizes)})",
            "(1,) * 10**9",
        )
    )
    kind = random.choice(("<f8", "|O", "<U999999999", "|V999999999", "|b1", "<c16"))
    header = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}"
    act = random.randrange(6)
    if act == 0:
        header = random.choice(
            (
                "(" * 9000,
                "{" * 9000,
                "[" * 60000,
                "9" * 60000,
                "-" * 60000,
                "'" * 99,
                "\n" * 60000,
                "{'a':" * 9000,
            )
        )
    elif act == 1:
        header = header.replace("}", "'x': __import__('os').abort(), }")
    body = pickle.dumps([1, 2]) if kind == "|O" else bytes(8 * COUNT)
    version = (
        random.choice((b"\1\0", b"\1\0", b"\2\0", b"\3\0")) if len(header) < 60000 else b"\2\0"
    )
    door: Door = random.choice(("values", "map"))
    return Specimen("a.npy", door, _npy(header, body, version))


def tables(random: Random) -> Specimen:
    """Text with very long lines, very many columns or numbers of very many digits."""
    n = random.choice((10**4, 2 * 10**5, 5 * 10**6))
    content = random.choice(
        (
            *(b'"' + b"x" * n + b'",1\n1,2\n', b"1," * n + b"1\n", b"1 " * n, b"9" * n + b"\n"),
            *(b"0." + b"3" * n + b"\n" + b"1\n" * 42, b"\n" * n, b"#\n" * n, b"1\n" * n),
            *(b"nan\n" * COUNT, b'"' * n, b"1" + b"\0" * n, ("1\n" * n).encode("utf-16")),
            *(b"\xff" * n, b"a,b\n" + b"1,2,3\n" * n),
        )
    )
    door: Door = random.choice(("values", "map"))
    return Specimen(
        random.choice(("a.csv", "a.txt", "a.vts", "a.sym.vts")), door, content[: 9 << 20]
    )


def bombs(random: Random) -> Specimen:
    """Results and projects whose members expand, overlap, are very many, or unknown and large."""
    name = random.choice(("result.npz", "plain.abfm", "rich.abfm"))
    specimen, method = (
        specimens()[name],
        random.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)),
    )
    file = io.BytesIO(specimen.content)
    act = random.randrange(4)
    with zipfile.ZipFile(file, "a", method) as archive:
        if act == 0:
            big = np.zeros(random.choice((10**6, 10**8)), dtype=np.uint8)
            with archive.open(
                random.choice(("x.npy", "known/9.npy", "x.json")), "w", force_zip64=True
            ) as member:
                for _ in range(random.choice((1, 8))):
                    member.write(big)
        elif act == 1:
            for k in range(random.choice((10**3, 3 * 10**4))):
                archive.writestr(zipfile.ZipInfo(f"{k}.npy"), b"")
        elif act == 2:
            archive.comment = b"PK\5\6" * 10**4
        else:
            archive.writestr(
                zipfile.ZipInfo("format_version.npy"),
                _npy("{" + " " * 9 * 10**6 + "}", version=b"\2\0"),
            )
    return Specimen(name, specimen.door, file.getvalue()[: 10 << 20])


def quine(random: Random) -> Specimen:
    """A zip all of whose entries are one large member."""
    inner = _npy(
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000,), }", bytes(8 * 10**6)
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(zipfile.ZipInfo("0.npy"), inner)
    data = file.getvalue()
    begin, end = data.find(b"PK\1\2"), data.find(b"PK\5\6")
    record, count = data[begin:end], random.choice((100, 5000, 60000))
    records = b"".join(record[:-5] + f"{k % 10**1}.npy".encode() for k in range(count))
    tail = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, count, count, len(records), begin, 0)
    door: Door = random.choice(("result", "project"))
    return Specimen("a.npz" if door == "result" else "a.abfm", door, data[:begin] + records + tail)


def numbers(random: Random) -> Specimen:
    """Results with counts and parameters beyond everything."""
    with np.load(io.BytesIO(specimens()["result.npz"].content)) as result:
        arrays = dict(result)
    act = random.randrange(7)
    if act == 0:
        arrays["file_vertex_count"] = np.array(
            random.choice((10**7, 10**8, 10**12, 4 * 10**18, -1))
        )
    elif act == 1:
        arrays["velocity"] = arrays["velocity"] * random.choice((1e10, 1e100, 1e300))
    elif act == 2:
        arrays["parameters"] = np.array(
            random.choice(
                ('{"tau": 1e308}', "{}", "[" * 10**5, '{"tau": ' + "9" * 10**5 + "}", "null")
            )
        )
    elif act == 3:
        arrays["format_version"] = random.choice(
            (np.arange(10**5), np.array("1"), np.array(2**62), np.array([]), np.array(1.0))
        )
    elif act == 4:
        arrays["mask" if random.random() < 0.5 else "weights"] *= random.choice((-1.0, 1e300, 0.0))
    elif act == 5:
        arrays["verdict"] = np.array(["x" * 10**5, "a\nb", "\0"])
    else:
        arrays["stop_reason"] = np.array(random.choice(("x" * 10**6, "a\nb\nc", "", "\udc80")))
    file = io.BytesIO()
    np.savez(file, **arrays)
    return Specimen("result.npz", "result", file.getvalue())


def json_texts(random: Random) -> Specimen:
    """JSON that nests, repeats or holds numbers without end: in projects and in what is kept
    between launches.
    """
    text = random.choice(
        (
            *("[" * 10**6, "[" * 10**5 + "]" * 10**5, '{"a":' * 10**5 + "1" + "}" * 10**5),
            *("9" * 10**6, "1e" + "9" * 10**5, "[" + "0," * 10**6 + "0]"),
            json.dumps(["/x" * 10**4] * 100),
            *(json.dumps(["\0", "\udc80", "a\nb", 5, None, {}, []]), '"' + "x" * 9 * 10**6 + '"'),
            '{"format_version": ' + "9" * 5000 + "}",
            '{"theme": ["dark"], "ui_scale": 1e999, "follow": 3}',
            *('{"theme": {}, "ui_scale": NaN}', "", "\ufeff{}"),
        )
    )
    name = random.choice(("recent.json", "preferences.json", "rich.abfm"))
    if name != "rich.abfm":
        return Specimen(
            name,
            "recent" if name == "recent.json" else "preferences",
            text.encode("utf-8", "surrogatepass"),
        )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        member = random.choice(("project.json", "origin.json"))
        archive.writestr(zipfile.ZipInfo(member), text.encode("utf-8", "surrogatepass"))
        if member == "origin.json":
            with zipfile.ZipFile(io.BytesIO(specimens()[name].content)) as good:
                for info in good.infolist():
                    archive.writestr(info, good.read(info))
    return Specimen(name, "project", file.getvalue())


def specs(random: Random) -> Specimen:
    """Functions as text that nest, repeat, or ask for numbers without end."""
    n = random.choice((50, 1000, 10**5))
    text = random.choice(
        (
            "permuted:mirror(" * n + "coordinate:x" + ")" * n,
            "expression:" + "(" * n + "x" + ")" * n,
            "expression:" + "-" * n + "x",
            "expression:x" + "+x" * n,
            "expression:x" + "**x" * n,
            " + ".join(["coordinate:x"] * n),
            "expression:9**9**9**9",
            "expression:9**9**9",
            "expression:10**" + "9" * min(n, 1000),
            "expression:'a'*10**9",
            "expression:[x]*10**9",
            "expression:[x for y in z]",
            "expression:().__class__.__base__.__subclasses__()",
            "expression:open('/etc/passwd')",
            "expression:where(x>0,1/0,x)",
            "expression:exp(exp(exp(9+x)))",
            "expression:1<<10**9",
            "expression:" + "9" * n,
            "eigenfunction:"
            + random.choice(("99999999999999999999", "41", "42", "43", "1000000", "-1")),
            "wks:energy=1,eigenpairs="
            + random.choice(("1", "42", "1000000000", "99999999999999999999")),
            "hks:time=" + random.choice(("1e-320", "1e308", "0", "-1", "nan")),
            "gaussian:vertex=3,width=" + random.choice(("1e-320", "1e-162", "1e308", "1e-9", "0")),
            "gaussian:x=1e308,y=-1e308,z=1e308",
            "gaussian:x=1e-320,y=0,z=0,height=1e308 + gaussian:x=0,y=0,z=0,height=1e308",
            "geodesic:vertex=" + "1" * n,
            "indicator:vertex=3,radius=1e308",
            "indicator:axis=x,above=-1e308",
            "gaussian:vertex=3,height=1e308 + gaussian:vertex=3,height=1e308",
            "gaussian:vertex=3,height=1e-320",
            'file:"' + "a/" * n + 'x.csv"',
            'file:"/dev/zero.csv"',
            'permuted:"' + "x" * n + '.txt"(coordinate:x)',
            "☃" * n,
            "\n" * n,
            "a:" * n,
            "," * n,
            '"' * n,
        )
    )
    return Specimen("a.spec", "spec", text.encode())


MAKERS = (npy, tables, bombs, quine, numbers, json_texts, specs, specs)

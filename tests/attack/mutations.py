"""Valid files that are changed at random."""

import gzip
import io
import json
import re
import struct
import warnings
import zipfile
from dataclasses import replace

from tests.attack.specimens import specimens

_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[^\s,;=:\"'(){}\[\]<>/]+")
_NUMBERS = (
    *(b"0", b"-0", b"1", b"-1", b"2", b"0.5", b"1e-320", b"1e9", b"1e155", b"1e309", b"nan"),
    *(b"2147483648", b"4294967295", b"9223372036854775808", b"-9223372036854775809", b"1" * 400),
    *(b"1" * 5000, b"0x10", b"1_000", b"1,5", b"1/2", b"1//3", b"1j", b"True", b"None", b"", b" "),
    *(b"-inf", b"1e+", b".", "٣".encode()),
)
_WORDS = (
    *(b"", b" ", b"\0", b"\xff\xfe", b"\xc3\xa9", b"\xed\xb2\x80", b"a" * 300, b"x\ny", b"\r"),
    *(b"#", b"'", b'"', b"(", b"[[[[", b"}", b"&amp;", b"<", b"%s", b"../../etc/passwd"),
    *(b"/dev/zero", b"~nobody/x", b"\x1b[31mred", b"=1+1", b"ASCII", b"BigEndian", b"<i8"),
)
_PIECES = (
    *(b"", b"\0", b"\xff", b" ", b"9", b"\n", b"\r", b"0 0 0\n", b"\n" * 300, bytes(1000)),
    *(
        struct.pack(order + kind, value)
        for order in "<>"
        for kind, values in (
            ("f", (float("nan"), float("inf"), 3e38, 1e-40, -1.0)),
            ("d", (float("nan"), 1e308, 5e-324, -1.0)),
            ("i", (0, -1, 2**31 - 1, -(2**31), 10**8)),
            ("q", (-1, 2**62, -(2**63))),
            ("I", (0x7FA00000,)),  # a signalling NaN
        )
        for value in values
    ),
)
_VALUES = (
    *(None, True, 0, -1, 0.5, 2**31, 2**63, 10**400, 1e308, float("nan"), float("inf"), "", "x"),
    *("é☃", "\udc80", "\0", "x" * 1000, "a\nb", "=1", "\x1b[31m", "../x", "/dev/zero"),
    *([], [0], [1, 2, 3], [[]], ["x"], {}, {"x": 1}, [0] * 1000),
)
_LARGEST = 2 << 20


def mutant(chance):
    """Return a specimen (a small valid file) after random changes, and the names of the changes."""
    specimen = specimens()[chance.choice(list(specimens()))]
    content, companions, done = specimen.content, dict(specimen.companions), []
    is_packed = specimen.name.endswith((".gz", ".mgz")) and chance.random() < 0.8
    if is_packed:
        content = gzip.decompress(content)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        name, mutation = chance.choice(list(MUTATIONS.items()))
        done.append(name)
        if companions and specimen.reader != "batch" and chance.random() < 0.3:
            other = chance.choice(sorted(companions))
            companions[other] = mutation(chance, companions[other])[:_LARGEST]
        else:
            content = mutation(chance, content)[:_LARGEST]
    if is_packed:
        content = gzip.compress(content, mtime=0)
    return replace(specimen, content=content, companions=companions), "+".join(done)


def _place(chance, data):
    """Return a random position in a file, in half of the cases near its beginning."""
    return chance.randint(0, min(len(data), 400) if chance.random() < 0.5 else len(data))


def _bits(chance, data):
    changed = bytearray(data)
    for _ in range(chance.choice((1, 2, 8)) if data else 0):
        changed[min(_place(chance, data), len(data) - 1)] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _piece(chance, data):
    """Insert, overwrite, delete or repeat a random block of bytes."""
    step = chance.choice((1, 4, 8))
    begin = _place(chance, data) // step * step
    end = begin + chance.choice((0, 1, 4, 8, 100, max(len(data) // 3, 1)))
    piece = chance.choice((*_PIECES, data[begin:end], data[_place(chance, data) :]))
    times = chance.choice((1, 2, max(end - begin, 1) // max(len(piece), 1)))
    return data[:begin] + piece * times + data[chance.choice((begin, end)) :]


def _replaced(chance, data, pattern, choices):
    """Replace a few matches of a pattern by random choices."""
    for _ in range(chance.choice((1, 1, 3))):
        if match := pattern.search(data, _place(chance, data)) or pattern.search(data):
            data = data[: match.start()] + chance.choice(choices) + data[match.end() :]
    return data


def _words(chance, data):
    """Replace words by strange ones, or by other words of the file."""
    known = _WORD.findall(data[:20_000]) or [b"x"]
    return _replaced(chance, data, _WORD, _WORDS if chance.random() < 0.5 else known)


def _lines(chance, data):
    """Replace, insert or delete a line, or change the line ends of the file."""
    rows = data.split(b"\n")
    place, other = chance.randrange(len(rows)), chance.choice(rows)
    rows[place : place + chance.choice((0, 1))] = chance.choice(([], [other]))
    bom = chance.choice((b"", b"", b"\xef\xbb\xbf"))
    return bom + chance.choice((b"\n", b"\n", b"\r\n", b"\r", b"\n\n", b"\x85")).join(rows)


def _inside(chance, data):
    """Change a member of a zip, with the right checksum, or a value of a JSON text."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two members may have one name
        try:
            return _with_member(chance, data) if data[:2] == b"PK" else _with_value(chance, data)
        except (ValueError, zipfile.BadZipFile, RecursionError):  # already broken
            return _bits(chance, data)


def _with_member(chance, data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = [(info.filename, archive.read(info)) for info in archive.infolist()]
    place = chance.randrange(len(entries))
    name, content = entries[place]
    simple = [each for each in MUTATIONS if each != "inside" or content[:1] == b"{"]
    changed = MUTATIONS[chance.choice(simple)](chance, content)
    renamed = chance.choice(entries)[0], content
    entries[place : place + 1] = chance.choice(([], [renamed], *(5 * [[(name, changed)]])))
    methods = zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, *(9 * [zipfile.ZIP_STORED])
    method, file = chance.choice(methods), io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in entries:
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return file.getvalue()


def _with_value(chance, data):
    root = [json.loads(data)]
    place, key = root, 0
    while isinstance(place[key], dict | list) and place[key] and chance.random() < 0.8:
        place = place[key]
        key = chance.choice(list(place) if isinstance(place, dict) else range(len(place)))
    place[key] = chance.choice(_VALUES)
    return json.dumps(root[0]).encode("utf-8", "surrogatepass")


MUTATIONS = {
    "bits": _bits,
    "cut": lambda chance, data: data[: _place(chance, data)],
    "piece": _piece,
    "numbers": lambda chance, data: _replaced(chance, data, _NUMBER, _NUMBERS),
    "words": _words,
    "lines": _lines,
    "inside": _inside,
}
"""Changes of a file, by name."""

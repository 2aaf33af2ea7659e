"""Valid files made wrong at random."""

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
    *("0", "-0", "1", "-1", "2", "0.5", "1e-320", "1e9", "1e155", "1e309", "nan", "-inf", "1e+"),
    *("2147483648", "4294967295", "9223372036854775808", "-9223372036854775809", "1" * 400),
    *("1" * 5000, "0x10", "1_000", "1,5", "1/2", "1//3", "1j", "True", "None", "", " ", ".", "٣"),
)
_WORDS = (
    *(b"", b" ", b"\0", b"\xff\xfe", b"\xc3\xa9", b"\xed\xb2\x80", b"a" * 300, b"x\ny", b"\r"),
    *(b"#", b"'", b'"', b"(", b"[[[[", b"}", b"&amp;", b"<", b"%s", b"../../etc/passwd"),
    *(b"/dev/zero", b"~nobody/x", b"\x1b[31mred", b"=1+1", b"ASCII", b"BigEndian", b"<i8"),
)
_PACKED = [
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
]
_VALUES = (
    *(None, True, 0, -1, 0.5, 2**31, 2**63, 10**400, 1e308, float("nan"), float("inf"), "", "x"),
    *("é☃", "\udc80", "\0", "x" * 1000, "a\nb", "=1", "\x1b[31m", "../x", "/dev/zero"),
    *([], [0], [1, 2, 3], [[]], ["x"], {}, {"x": 1}, [0] * 1000),
)
_LARGEST = 2 << 20


def mutant(chance):
    """Return a specimen to which something was done, and what."""
    specimen = specimens()[chance.choice(list(specimens()))]
    content, beside, done = specimen.content, dict(specimen.beside), []
    is_packed = specimen.name.endswith((".gz", ".mgz")) and chance.random() < 0.8
    if is_packed:
        content = gzip.decompress(content)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        name, mutation = chance.choice(list(MUTATIONS.items()))
        done.append(name)
        if beside and specimen.door != "batch" and chance.random() < 0.3:
            other = chance.choice(sorted(beside))
            beside[other] = mutation(chance, beside[other])[:_LARGEST]
        else:
            content = mutation(chance, content)[:_LARGEST]
    if is_packed:
        content = gzip.compress(content, mtime=0)
    return replace(specimen, content=content, beside=beside), "+".join(done)


def _place(chance, data, length=0):
    """Return where something of a length begins: anywhere, half of the time near headers."""
    end = max(len(data) - length, 0)
    return chance.randint(0, min(end, 400) if chance.random() < 0.5 else end)


def _block(chance, data):
    length = chance.choice((1, 2, 4, 8, 16, 100, max(len(data) // 3, 1)))
    begin = _place(chance, data, length)
    return begin, min(begin + length, len(data))


def _bits(chance, data):
    changed = bytearray(data)
    for _ in range(chance.choice((1, 2, 8)) if data else 0):
        changed[min(_place(chance, data, 1), len(data) - 1)] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _overwritten(chance, data):
    begin, end = _block(chance, data)
    fill = chance.choice((b"\0", b"\xff", b" ", b"9", b"\n")) * (end - begin)
    return data[:begin] + fill + data[end:]


def _packed_number(chance, data):
    number, step = chance.choice(_PACKED), chance.choice((1, 4, 8))
    begin = _place(chance, data, len(number)) // step * step
    return data[:begin] + number + data[begin + len(number) :]


def _deleted(chance, data):
    begin, end = _block(chance, data)
    return data[:begin] + data[end:]


def _doubled(chance, data):
    begin, end = _block(chance, data)
    place = chance.choice((end, _place(chance, data)))
    return data[:place] + data[begin:end] * chance.choice((1, 5)) + data[place:]


def _cut(chance, data):
    return data[: _place(chance, data)]


def _extended(chance, data):
    return data + chance.choice((data, bytes(1000), b"\n", b"0 0 0\n", b"\n" * 300))


def _replaced(chance, data, pattern, by):
    found = list(pattern.finditer(data))
    for _ in range(min(len(found), chance.choice((1, 1, 2)))):
        match = found[chance.randrange(len(found))]
        data = data[: match.start()] + by() + data[match.end() :]
        found = [other for other in found if other.end() <= match.start()]
        if not found:
            break
    return data


def _numbers(chance, data):
    return _replaced(chance, data, _NUMBER, lambda: chance.choice(_NUMBERS).encode())


def _words(chance, data):
    """Replace words by strange ones, or by other words of the file."""
    known = _WORD.findall(data[:20_000]) or [b"x"]
    strange = chance.random() < 0.5
    return _replaced(chance, data, _WORD, lambda: chance.choice(_WORDS if strange else known))


def _lines(chance, data):
    """Move, double or drop lines, or change their ends."""
    rows = data.split(b"\n")
    first, second = chance.randrange(len(rows)), chance.randrange(len(rows))
    act = chance.randrange(5)
    if act == 0:
        del rows[first]
    elif act == 1:
        rows.insert(second, rows[first])
    elif act == 2:
        rows[first], rows[second] = rows[second], rows[first]
    elif act == 3:
        return chance.choice((b"\r\n", b"\r", b"\n\n", b"\x85")).join(rows)
    else:
        return b"\xef\xbb\xbf" + data
    return b"\n".join(rows)


def _inside(chance, data):
    """Change a member of a zip, with the right checksum, or a value of a JSON text."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two members of one name are meant
        try:
            return _with_member(chance, data) if data[:2] == b"PK" else _with_value(chance, data)
        except (ValueError, zipfile.BadZipFile, RecursionError):  # it is broken already
            return _bits(chance, data)


def _with_member(chance, data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = [(info.filename, archive.read(info)) for info in archive.infolist()]
    index, other = chance.randrange(len(entries)), chance.randrange(len(entries))
    name, content = entries[index]
    act, method = chance.randrange(8), zipfile.ZIP_STORED
    if act == 0:
        entries[index] = entries[other][0], content
    elif act == 1:
        del entries[index]
    elif act == 2:
        method = chance.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    else:
        simple = [name for name in MUTATIONS if name != "inside" or content[:1] == b"{"]
        entries[index] = name, MUTATIONS[chance.choice(simple)](chance, content)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
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
    "overwritten": _overwritten,
    "packed number": _packed_number,
    "deleted": _deleted,
    "doubled": _doubled,
    "cut": _cut,
    "extended": _extended,
    "numbers": _numbers,
    "words": _words,
    "lines": _lines,
    "inside": _inside,
}
"""What can be done to a file, by name."""

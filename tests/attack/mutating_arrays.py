"""NumPy files and zips of them made wrong at random: headers and data inside, members, sizes;
checksums are mended.
"""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from random import Random

from tests.attack import mutating
from tests.attack.mutating import NUMBERS, WORDS, Mutation
from tests.attack.mutating_trees import json_text

_SHAPES = (
    *("()", "(0,)", "(1,)", "(42,)", "(42, 3)", "(3, 42)", "(42, 3, 1)", "(-1,)"),
    *("(4611686018427387904,)", "(2**62,)", "(1000000000000, 1000000000000)", "(100000000000,)"),
    *("(42", "42", "(42.0,)", "(True,)", "[42]", "(42, 0)", "(0, 99999999999)", "(1,) * 9"),
    *("(" + "1, " * 64 + ")", "(" * 300, "None", "'x'"),
)
_TYPES = (
    *("'<f4'", "'>f8'", "'<f2'", "'<i4'", "'<i8'", "'<u8'", "'|b1'", "'|i1'", "'<c16'", "'|O'"),
    *("'<M8[s]'", "'|V8'", "'|S8'", "'<U1'", "'<U1000000000'", "'<f16'", "'f'", "''", "'x'", "0"),
    *("None", "[('a', '<f8')]", "[('a', '|O')]", "'<f8,<f8'", "'(2,)<f8'"),
)
_NAMES = (
    *("mesh/vertices.npy", "mesh/faces.npy", "velocity.npy", "x.npy", "x", "../x.npy", "/x.npy"),
    *("", "é.npy", "project.json"),
)
_METHODS = (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)


def npy(random: Random, data: bytes) -> bytes:
    """A .npy file with a header or data that lie."""
    if data[:6] != b"\x93NUMPY" or len(data) < 10:
        return data
    end = 10 + int.from_bytes(data[8:10], "little")
    header, body = data[10:end].decode("latin-1"), data[end:]
    act = random.randrange(8)
    if act == 0:
        before, _, after = header.partition("'shape': ")
        header = f"{before}'shape': {random.choice(_SHAPES)}{after[after.find(')') + 1 :]}"
    elif act == 1:
        before, _, after = header.partition("'descr': ")
        header = f"{before}'descr': {random.choice(_TYPES)}{after[after.find(',') :]}"
    elif act == 2:
        header = header.replace("False", random.choice(("True", "1", "None", "'x'")))
    elif act == 3:
        place = random.randrange(len(header) or 1)
        header = header[:place] + chr(random.randrange(256)) + header[place + random.randrange(2) :]
    elif act == 4:
        header = header.replace("'shape'", random.choice(("'shape ", "'x'", "'descr'", "shape")))
    elif act == 5:
        body = random.choice((mutating.packed_numbers, mutating.bits, mutating.swapped))(
            random, body
        )
    elif act == 6:
        body = random.choice((mutating.truncated, mutating.extended, mutating.deleted))(
            random, body
        )
    else:
        version = random.choice((b"\1\0", b"\2\0", b"\3\0", b"\x09\0"))
        length = random.choice((len(header), 0, 1, 65535, len(header) - 3))
        return (
            data[:6]
            + version
            + struct.pack(random.choice(("<H", "<I")), max(length, 0) & 0xFFFF)
            + header.encode("latin-1")
            + body
        )
    if random.random() < 0.5:  # as NumPy writes it: a multiple of 64 bytes
        header = header.rstrip() + " " * (-(len(header.rstrip()) + 11) % 64) + "\n"
    return data[:8] + struct.pack("<H", len(header) & 0xFFFF) + header.encode("latin-1") + body


def members(random: Random, data: bytes) -> bytes:
    """A zip whose members are others, with the checksums that they must have."""
    entries = _entries(data)
    if not entries:
        return data
    index, other = random.randrange(len(entries)), random.randrange(len(entries))
    name, content = entries[index]
    act, method = random.randrange(14), zipfile.ZIP_STORED
    if act == 0:
        entries[index] = (
            random.choice((*_NAMES, name.upper(), name[:-4], entries[other][0])),
            content,
        )
    elif act == 1:
        entries[index], entries[other] = (name, entries[other][1]), (entries[other][0], content)
    elif act == 2:
        del entries[index]
    elif act == 3:
        entries.append((name, entries[other][1]))
    elif act == 4:
        method = random.choice(_METHODS)
    elif act == 5:
        entries.insert(
            index, (random.choice(_NAMES), random.choice((content, b"", random.randbytes(90))))
        )
    elif act == 6:
        random.shuffle(entries)
    elif act == 7:
        entries[index] = name, mutating.ANY[random.randrange(len(mutating.ANY))](random, content)
    else:
        inside: Mutation = json_text if name.endswith(".json") or random.random() < 0.2 else npy
        target = (
            next((k for k, (n, _) in enumerate(entries) if n.endswith(".json")), index)
            if inside is json_text
            else index
        )
        entries[target] = entries[target][0], inside(random, entries[target][1])
    return _zip(entries, method)


def _entries(data: bytes) -> list[tuple[str, bytes]]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:  # it is broken already
        return []


def _zip(entries: list[tuple[str, bytes]], method: int = zipfile.ZIP_STORED) -> bytes:
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w", method) as archive:
        warnings.simplefilter("ignore")  # two members of one name are meant
        for name, content in entries:
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return file.getvalue()


def directory(random: Random, data: bytes) -> bytes:
    """Records of a zip that lie about places, sizes, methods and flags."""
    for _ in range(random.choice((1, 1, 2, 4))):
        mark = random.choice((b"PK\1\2", b"PK\1\2", b"PK\3\4", b"PK\5\6"))
        places = [place for place in range(len(data)) if data[place : place + 4] == mark]
        if not places:
            continue
        field = random.choice(places) + random.randrange(
            4, {b"PK\1\2": 46, b"PK\3\4": 30, b"PK\5\6": 22}[mark], 2
        )
        value = random.choice(
            (
                *(0, 1, 8, 12, 14, 99, 0xFFFF, 0xFFFFFFFF, random.randrange(2**16)),
                random.randrange(len(data) or 1),
            )
        )
        width = random.choice((2, 4))
        data = (
            data[:field]
            + (value & (256**width - 1)).to_bytes(width, "little")
            + data[field + width :]
        )
    return data


def overlapping(random: Random, data: bytes) -> bytes:
    """A zip in which all members lie at the place of one."""
    places = [place for place in range(len(data)) if data[place : place + 4] == b"PK\1\2"]
    if not places:
        return data
    one = random.choice(places)
    changed = bytearray(data)
    for place in places:
        changed[place + 42 : place + 46] = data[one + 42 : one + 46]
        if random.random() < 0.5:
            changed[place + 16 : place + 28] = data[one + 16 : one + 28]
    return bytes(changed)


def json_member(random: Random, data: bytes) -> bytes:
    """A project's JSON with other values, its words and numbers as strange as may be."""
    entries = _entries(data)
    for k, (name, content) in enumerate(entries):
        if name.endswith(".json"):
            changed = json_text(random, content)
            if random.random() < 0.2:
                word = random.choice((*WORDS, *(number.encode() for number in NUMBERS)))
                changed = content.replace(
                    random.choice((b"0.5", b"coordinate", b"null", b"true", b"3")), word, 1
                )
            entries[k] = name, changed
    return _zip(entries) if entries else data

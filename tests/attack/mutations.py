"""Valid files made wrong at random, opened through the users' doors."""

import base64
import gzip
import io
import json
import re
import struct
import warnings
import zipfile
import zlib
from copy import deepcopy
from dataclasses import replace
from random import Random

from tests.attack.specimens import specimens
from tests.attack.victim import run_victim

_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[^\s,;=:\"'(){}\[\]<>/]+")
NUMBERS = (
    *("0", "-0", "1", "-1", "2", "0.5", "1e-320", "1e-162", "1e-9", "1e9", "1e155", "1e308"),
    *("1e309", "-1e309", "1e99999", "nan", "-nan", "inf", "-inf", "Infinity", "NaN", "2147483647"),
    *("2147483648", "-2147483649", "4294967295", "9223372036854775807", "9223372036854775808"),
    *("-9223372036854775809", "18446744073709551616", "4611686018427387904", "1" * 400),
    *("1" * 5000, "0x10", "1_000", "1,5", "1/2", "1//3", "1d5", "1j", "True", "None", "", " "),
    *("-", "+", ".", "e5", "٣"),
)
"""What stands where a number should."""
WORDS = (
    *(b"", b" ", b"\0", b"\xff\xfe", b"\xc3\xa9", b"\xe2\x98\x83", b"\xed\xb2\x80", b"a" * 300),
    *(b"x\ny", b"\r", b"#", b"//", b"'", b'"', b"()", b"(", b")", b"[[[[", b"}", b"&amp;", b"<"),
    *(b"%s", b"%n", b"../../etc/passwd", b"/dev/zero", b".", b"~nobody/x"),
)
"""What stands where a word should."""
_FROM_TEXT = (*WORDS, *(number.encode() for number in NUMBERS))
_PACKED = [
    struct.pack(order + kind, value)
    for order in "<>"
    for kind, values in (
        ("f", (float("nan"), float("inf"), -float("inf"), 3e38, 1e-40, -1.0, 0.0)),
        ("d", (float("nan"), float("inf"), -float("inf"), 1e308, 5e-324, -1.0, 1e-200)),
        ("i", (0, -1, 1, 2**31 - 1, -(2**31), 10**8)),
        ("q", (-1, 2**31, 2**62, 2**63 - 1, -(2**63), 10**11)),
        ("h", (-1, 0, 2**15 - 1)),
    )
    for value in values
]
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
_VALUES = (
    *(None, True, False, 0, 1, -1, 2, 0.5, -0.5, 10**8, 2**31, 2**53, 2**62, 2**63, 10**30),
    *(10**400, 1e308, -1e308, 1e-308, float("nan"), float("inf"), "", "x", "é☃", "\udc80", "\0"),
    *("x" * 1000, "a\nb", "1", "nan", "1e9", "../x", "/dev/zero", [], [0], [1, 2, 3], [[]], ["x"]),
    *({}, {"x": 1}, {"": None}, [0] * 1000, [None, {}]),
)
_ATTRIBUTE = re.compile(rb'(\w+)="([^"]*)"')
_ELEMENT = re.compile(
    rb"<(DataArray|Data|DataSpace|MetaData|GIFTI|LabelTable|Label)\b.*?</\1>", re.DOTALL
)
_DATA = re.compile(rb"(?<=<Data>).*?(?=</Data>)", re.DOTALL)
_ATTRIBUTES = (
    *(b"ASCII", b"Base64Binary", b"GZipBase64Binary", b"ExternalFileBinary", b"BigEndian"),
    *(b"LittleEndian", b"RowMajorOrder", b"ColumnMajorOrder", b"NIFTI_TYPE_FLOAT64"),
    *(b"NIFTI_TYPE_UINT8", b"NIFTI_TYPE_INT64", b"NIFTI_TYPE_COMPLEX64", b"NIFTI_INTENT_SHAPE"),
    *(b"NIFTI_INTENT_POINTSET", b"NIFTI_INTENT_TRIANGLE", b"3", b"42", b"a.surf.gii"),
    *(b"/dev/zero", b"&#0;", b"\xff"),
)
_RECORDS = {b"PK\1\2": 46, b"PK\3\4": 30, b"PK\5\6": 22}  # of a zip, and their lengths
_LARGEST = 2 << 20
_FREQUENT = {"project": 3, "result": 5}  # doors


def mutant(seed):
    """The mutant of a seed, always the same, and what was done to which specimen."""
    random, known = Random(seed), specimens()
    names = [name for name, one in known.items() for _ in range(_FREQUENT.get(one.door, 1))]
    specimen = known[random.choice(names)]
    fitting = _FITTING.get("." + specimen.name.removesuffix(".gz").rpartition(".")[2], ())
    choice = (*ANY, *fitting) if random.random() < 0.5 else fitting or ANY
    done, content, beside = [], specimen.content, dict(specimen.beside)
    packed = specimen.name.endswith(".gz") and random.random() < 0.8
    if packed:
        content = gzip.decompress(content)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        mutation = random.choice(choice)
        if beside and random.random() < 0.4:
            name = random.choice(sorted(beside))
            beside[name] = random.choice(ANY)(random, beside[name])[:_LARGEST]
        else:
            content = mutation(random, content)[:_LARGEST]
        done.append(mutation.__name__)
    if packed:
        is_gzip = random.random() < 0.9
        content = gzip.compress(content, mtime=0) if is_gzip else zlib.compress(content)
    return replace(specimen, content=content, beside=beside), f"{specimen.name} {'+'.join(done)}"


# Of any file, whatever its format


def _place(random, data, length=0):
    """Where something of a length begins: anywhere, half of the time near headers."""
    end = max(len(data) - length, 0)
    return random.randint(0, min(end, 400) if random.random() < 0.5 else end)


def _block(random, data):
    length = random.choice((1, 2, 4, 8, 16, 100, max(len(data) // 3, 1)))
    begin = _place(random, data, length)
    return begin, min(begin + length, len(data))


def bits(random, data):
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8))):
        if changed:
            changed[min(_place(random, data, 1), len(data) - 1)] ^= 1 << random.randrange(8)
    return bytes(changed)


def overwritten(random, data):
    begin, end = _block(random, data)
    count = end - begin
    fill = random.choice((random.randbytes(count), bytes(count), b"\xff" * count))
    return data[:begin] + fill + data[end:]


def packed_numbers(random, data):
    """Binary numbers of all widths, aligned or not."""
    for _ in range(random.choice((1, 1, 3))):
        number = random.choice(_PACKED)
        begin = _place(random, data, len(number))
        begin = begin // random.choice((1, 4, 8)) * random.choice((1, 4, 8))
        data = data[:begin] + number + data[begin + len(number) :]
    return data


def inserted(random, data):
    begin = _place(random, data)
    some = random.randbytes(random.choice((1, 2, 7, 300)))
    return data[:begin] + random.choice((some, b"\n" * 200, b" " * 200, bytes(64))) + data[begin:]


def deleted(random, data):
    begin, end = _block(random, data)
    return data[:begin] + data[end:]


def doubled(random, data):
    begin, end = _block(random, data)
    place = random.choice((end, _place(random, data)))
    return data[:place] + data[begin:end] * random.choice((1, 1, 5)) + data[place:]


def truncated(random, data):
    return data[: _place(random, data)]


def extended(random, data):
    return data + random.choice((data, random.randbytes(20), bytes(1000), b"\n", b"0 0 0\n"))


def swapped(random, data):
    a, b, c, d = sorted(_place(random, data) for _ in range(4))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _replaced(random, data, pattern, by):
    found = list(pattern.finditer(data))
    chosen = random.sample(found, min(len(found), random.choice((1, 1, 2, 9))))
    for match in sorted(chosen, key=lambda m: -m.start()):
        data = data[: match.start()] + by() + data[match.end() :]
    return data


def numbers(random, data):
    """Numbers in text replaced by others, or by what is none."""
    return _replaced(random, data, _NUMBER, lambda: random.choice(NUMBERS).encode())


def words(random, data):
    """Words replaced by strange ones or by other words of the file."""
    known = _WORD.findall(data[:20_000]) or [b"x"]
    return _replaced(
        random, data, _WORD, lambda: random.choice(WORDS if random.random() < 0.5 else known)
    )


def lines(random, data):
    """Whole lines moved, doubled or gone, and other ends of lines."""
    rows = data.split(b"\n")
    first, second = random.randrange(len(rows)), random.randrange(len(rows))
    act = random.randrange(7)
    if act == 0:
        del rows[first]
    elif act == 1:
        rows.insert(second, rows[first])
    elif act == 2:
        rows[first], rows[second] = rows[second], rows[first]
    elif act == 3:
        row = random.choice((b"", b"# a comment", b"comment x", b"\t"))
        rows[first:first] = [row] * random.choice((1, 500))
    elif act == 4:
        return random.choice((b"\r\n", b"\r", b"\n\n", b" \\\n", b"\x85", b" ")).join(rows)
    elif act == 5:
        rows[first] += b" " + rows[second]
    else:
        marked = random.random() < 0.5
        return b"\xef\xbb\xbf" + data if marked else data.decode("latin-1").encode("utf-16")
    return b"\n".join(rows)


# NumPy files and zips of them; checksums are mended


def npy(random, data):
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
        body = random.choice((packed_numbers, bits, swapped))(random, body)
    elif act == 6:
        body = random.choice((truncated, extended, deleted))(random, body)
    else:
        version = random.choice((b"\1\0", b"\2\0", b"\3\0", b"\x09\0"))
        length = random.choice((len(header), 0, 1, 65535, len(header) - 3))
        size = struct.pack(random.choice(("<H", "<I")), max(length, 0) & 0xFFFF)
        return data[:6] + version + size + header.encode("latin-1") + body
    if random.random() < 0.5:  # as NumPy writes it: a multiple of 64 bytes
        header = header.rstrip() + " " * (-(len(header.rstrip()) + 11) % 64) + "\n"
    return data[:8] + struct.pack("<H", len(header) & 0xFFFF) + header.encode("latin-1") + body


def members(random, data):
    """A zip whose members are others, with the checksums that they must have."""
    entries = _entries(data)
    if not entries:
        return data
    index, other = random.randrange(len(entries)), random.randrange(len(entries))
    name, content = entries[index]
    act, method = random.randrange(14), zipfile.ZIP_STORED
    if act == 0:
        names = (*_NAMES, name.upper(), name[:-4], entries[other][0])
        entries[index] = random.choice(names), content
    elif act == 1:
        entries[index], entries[other] = (name, entries[other][1]), (entries[other][0], content)
    elif act == 2:
        del entries[index]
    elif act == 3:
        entries.append((name, entries[other][1]))
    elif act == 4:
        method = random.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    elif act == 5:
        new = random.choice(_NAMES), random.choice((content, b"", random.randbytes(90)))
        entries.insert(index, new)
    elif act == 6:
        random.shuffle(entries)
    elif act == 7:
        entries[index] = name, ANY[random.randrange(len(ANY))](random, content)
    else:
        inside = json_text if name.endswith(".json") or random.random() < 0.2 else npy
        texts = [k for k, (name, _) in enumerate(entries) if name.endswith(".json")]
        index = (texts or [index])[0] if inside is json_text else index
        entries[index] = entries[index][0], inside(random, entries[index][1])
    return _zip(entries, method)


def _entries(data):
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:  # it is broken already
        return []


def _zip(entries, method=zipfile.ZIP_STORED):
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w", method) as archive:
        warnings.simplefilter("ignore")  # two members of one name are meant
        for name, content in entries:
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return file.getvalue()


def _records(data, mark):
    return [place for place in range(len(data)) if data[place : place + 4] == mark]


def directory(random, data):
    """Records of a zip that lie about places, sizes, methods and flags."""
    for _ in range(random.choice((1, 1, 2, 4))):
        mark = random.choice((b"PK\1\2", b"PK\1\2", b"PK\3\4", b"PK\5\6"))
        if not (places := _records(data, mark)):
            continue
        field = random.choice(places) + random.randrange(4, _RECORDS[mark], 2)
        known = (0, 1, 8, 12, 14, 99, 0xFFFF, 0xFFFFFFFF)
        value = random.choice((*known, random.randrange(2**16), random.randrange(len(data) or 1)))
        width = random.choice((2, 4))
        new = (value & (256**width - 1)).to_bytes(width, "little")
        data = data[:field] + new + data[field + width :]
    return data


def overlapping(random, data):
    """A zip in which all members lie at the place of one."""
    if not (places := _records(data, b"PK\1\2")):
        return data
    one, changed = random.choice(places), bytearray(data)
    for place in places:
        changed[place + 42 : place + 46] = data[one + 42 : one + 46]
        if random.random() < 0.5:
            changed[place + 16 : place + 28] = data[one + 16 : one + 28]
    return bytes(changed)


def json_member(random, data):
    """A project's JSON with other values, its words and numbers as strange as may be."""
    entries = _entries(data)
    for k, (name, content) in enumerate(entries):
        if name.endswith(".json"):
            changed = json_text(random, content)
            if random.random() < 0.2:
                word = random.choice(_FROM_TEXT)
                known = random.choice((b"0.5", b"coordinate", b"null", b"true", b"3"))
                changed = content.replace(known, word, 1)
            entries[k] = name, changed
    return _zip(entries) if entries else data


# JSON and XML: values of another type, fields gone or new, attributes that lie


def json_text(random, data):
    """One or a few values of a JSON text replaced, removed or added; other text stays as it is."""
    try:
        tree = json.loads(data)
    except ValueError:
        return data
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        tree = _changed(random, tree)
    return json.dumps(tree).encode("utf-8", "surrogateescape")


def _changed(random, tree):
    keys = list(tree) if isinstance(tree, dict) else []
    if isinstance(tree, list):
        keys = list(range(len(tree)))
    if not keys or random.random() < 0.12:
        if isinstance(tree, int | float) and random.random() < 0.4:
            half = tree * 0.5 if abs(tree) < 1e300 else 0
            return random.choice((tree + 1, -tree, tree * 1000, tree - 1, half))
        return deepcopy(random.choice(_VALUES))
    key, act = random.choice(keys), random.random()
    if act < 0.75:
        tree[key] = _changed(random, tree[key])
    elif act < 0.83:
        del tree[key]
    elif act < 0.9:
        tree[key] = deepcopy(tree[random.choice(keys)])
    elif isinstance(tree, dict):
        value = deepcopy(random.choice(_VALUES))
        names = ("x", "", "extras", "sparse", "uri", "mesh", "matrix", key + "x")
        tree[random.choice(names)] = value
    else:
        tree.insert(key, deepcopy(random.choice((*_VALUES, tree[key]))))
    return tree


def glb(random, data):
    """The JSON in a GLB file, its lengths mended."""
    if data[:4] != b"glTF" or len(data) < 20:
        return data
    end = 20 + struct.unpack_from("<I", data, 12)[0]
    text, rest = json_text(random, data[20:end]), data[end:]
    text += b" " * (-len(text) % 4)
    size = 20 + len(text) + len(rest)
    return struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON") + text + rest


def xml(random, data):
    """Attributes, elements and data of a GIFTI file."""
    act = random.random()
    if act < 0.6:
        found = _ATTRIBUTE.search(data, random.randrange(len(data) or 1))
        if found:
            new = random.choice((*_ATTRIBUTES, *_FROM_TEXT))
            data = data[: found.start(2)] + new + data[found.end(2) :]
        return data
    elements = list((_ELEMENT if act < 0.75 else _DATA).finditer(data))
    if not elements:
        return data
    found, other = random.choice(elements), random.choice(elements)
    text = found[0]
    try:
        recoded = base64.b64encode(base64.b64decode(text)[::-1])
    except ValueError:
        recoded = text[::-1]
    new = random.choice((b"", text * 2, other[0], text[: len(text) // 2], text.lower(), recoded))
    return data[: found.start()] + new + data[found.end() :]


ANY = (
    *(bits, overwritten, packed_numbers, inserted, deleted, doubled, truncated, extended, swapped),
    *(numbers, words, lines),
)
"""For every file."""
_FITTING = {
    ".npy": (npy,) * 3,
    ".npz": (members,) * 3 + (directory, overlapping),
    ".abfm": (members,) * 2 + (json_member,) * 3 + (directory, overlapping),
    ".gii": (xml,) * 3,
    ".gltf": (json_text,) * 3,
    ".glb": (glb,) * 3,
    ".json": (json_text,) * 2,
    ".spec": (numbers, words),
}

if __name__ == "__main__":
    run_victim("mutations", "mutant", __doc__)

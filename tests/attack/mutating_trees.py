"""JSON and XML made wrong at random: values of another type, fields gone or new, attributes that
lie.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from copy import deepcopy
from random import Random
from typing import Any

from tests.attack.mutating import NUMBERS, WORDS

_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 0.5, -0.5, 10**8, 2**31, 2**53, 2**62, 2**63, 10**30),
    *(10**400, 1e308, -1e308, 1e-308, float("nan"), float("inf"), "", "x", "é☃", "\udc80", "\0"),
    *("x" * 1000, "a\nb", "1", "nan", "1e9", "../x", "/dev/zero", [], [0], [1, 2, 3], [[]], ["x"]),
    *({}, {"x": 1}, {"": None}, [0] * 1000, [None, {}]),
)
_ATTRIBUTE = re.compile(rb'(\w+)="([^"]*)"')
_ELEMENT = re.compile(rb"<(DataArray|Data|DataSpace|MetaData|GIFTI)\b.*?</\1>", re.DOTALL)
_DATA = re.compile(rb"(?<=<Data>).*?(?=</Data>)", re.DOTALL)
_ATTRIBUTES = (
    *(b"ASCII", b"Base64Binary", b"GZipBase64Binary", b"ExternalFileBinary", b"BigEndian"),
    *(b"LittleEndian", b"RowMajorOrder", b"ColumnMajorOrder", b"NIFTI_TYPE_FLOAT64"),
    *(b"NIFTI_TYPE_UINT8", b"NIFTI_TYPE_INT64", b"NIFTI_TYPE_COMPLEX64", b"NIFTI_INTENT_SHAPE"),
    *(b"NIFTI_INTENT_POINTSET", b"NIFTI_INTENT_TRIANGLE", b"3", b"42", b"a.surf.gii"),
    *(b"/dev/zero", b"&#0;", b"\xff"),
)


def json_text(random: Random, data: bytes) -> bytes:
    """One or a few values of a JSON text replaced, removed or added; other text stays as it is."""
    try:
        tree = json.loads(data)
    except ValueError:
        return data
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        tree = _changed(random, tree)
    return json.dumps(tree).encode("utf-8", "surrogateescape")


def _changed(random: Random, tree: Any) -> Any:
    keys = (
        list(tree)
        if isinstance(tree, dict)
        else list(range(len(tree)))
        if isinstance(tree, list)
        else []
    )
    if not keys or random.random() < 0.12:
        if isinstance(tree, int | float) and random.random() < 0.4:
            return random.choice(
                (tree + 1, -tree, tree * 1000, tree - 1, tree * 0.5 if abs(tree) < 1e300 else 0)
            )
        return deepcopy(random.choice(_VALUES))
    key, act = random.choice(keys), random.random()
    if act < 0.75:
        tree[key] = _changed(random, tree[key])
    elif act < 0.83:
        del tree[key]
    elif act < 0.9:
        tree[key] = deepcopy(tree[random.choice(keys)])
    elif isinstance(tree, dict):
        tree[random.choice(("x", "", "extras", "sparse", "uri", "mesh", "matrix", key + "x"))] = (
            deepcopy(random.choice(_VALUES))
        )
    else:
        tree.insert(key, deepcopy(random.choice((*_VALUES, tree[key]))))
    return tree


def glb(random: Random, data: bytes) -> bytes:
    """The JSON in a GLB file, its lengths mended."""
    if data[:4] != b"glTF" or len(data) < 20:
        return data
    length = struct.unpack_from("<I", data, 12)[0]
    text = json_text(random, data[20 : 20 + length])
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return (
        struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
        + text
        + rest
    )


def xml(random: Random, data: bytes) -> bytes:
    """Attributes, elements and data of a GIFTI file."""
    act = random.random()
    if act < 0.6:
        found = _ATTRIBUTE.search(data, random.randrange(len(data) or 1))
        if found:
            new = random.choice((*_ATTRIBUTES, *WORDS, *(number.encode() for number in NUMBERS)))
            data = data[: found.start(2)] + new + data[found.end(2) :]
        return data
    elements = list(_ELEMENT.finditer(data) if act < 0.75 else _DATA.finditer(data))
    if not elements:
        return data
    found, other = random.choice(elements), random.choice(elements)
    new = random.choice(
        (
            b"",
            found[0] * 2,
            other[0],
            found[0][: len(found[0]) // 2],
            found[0].lower(),
            _recoded(found[0]),
        )
    )
    return data[: found.start()] + new + data[found.end() :]


def _recoded(text: bytes) -> bytes:
    """Base64 of other bytes as long."""
    try:
        return base64.b64encode(base64.b64decode(text)[::-1])
    except ValueError:
        return text[::-1]

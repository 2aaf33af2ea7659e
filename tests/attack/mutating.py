"""Files made wrong at random: bytes, numbers, words and lines of any file, whatever its format."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from random import Random

Mutation = Callable[[Random, bytes], bytes]
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


def _place(random: Random, data: bytes, length: int = 0) -> int:
    """Where something of a length begins: anywhere, but half of the time near the beginning,
    where headers are.
    """
    end = max(len(data) - length, 0)
    return random.randint(0, min(end, 400) if random.random() < 0.5 else end)


def _block(random: Random, data: bytes) -> tuple[int, int]:
    length = random.choice((1, 2, 4, 8, 16, 100, max(len(data) // 3, 1)))
    begin = _place(random, data, length)
    return begin, min(begin + length, len(data))


def bits(random: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8))):
        if changed:
            changed[min(_place(random, data, 1), len(data) - 1)] ^= 1 << random.randrange(8)
    return bytes(changed)


def overwritten(random: Random, data: bytes) -> bytes:
    begin, end = _block(random, data)
    fill = random.choice(
        (random.randbytes(end - begin), bytes(end - begin), b"\xff" * (end - begin))
    )
    return data[:begin] + fill + data[end:]


def packed_numbers(random: Random, data: bytes) -> bytes:
    """Binary numbers of all widths, aligned or not."""
    for _ in range(random.choice((1, 1, 3))):
        number = random.choice(_PACKED)
        begin = (
            _place(random, data, len(number)) // random.choice((1, 4, 8)) * random.choice((1, 4, 8))
        )
        data = data[:begin] + number + data[begin + len(number) :]
    return data


def inserted(random: Random, data: bytes) -> bytes:
    begin = _place(random, data)
    piece = random.choice(
        (random.randbytes(random.choice((1, 2, 7, 300))), b"\n" * 200, b" " * 200, bytes(64))
    )
    return data[:begin] + piece + data[begin:]


def deleted(random: Random, data: bytes) -> bytes:
    begin, end = _block(random, data)
    return data[:begin] + data[end:]


def doubled(random: Random, data: bytes) -> bytes:
    begin, end = _block(random, data)
    place = random.choice((end, _place(random, data)))
    return data[:place] + data[begin:end] * random.choice((1, 1, 5)) + data[place:]


def truncated(random: Random, data: bytes) -> bytes:
    return data[: _place(random, data)]


def extended(random: Random, data: bytes) -> bytes:
    return data + random.choice((data, random.randbytes(20), bytes(1000), b"\n", b"0 0 0\n"))


def swapped(random: Random, data: bytes) -> bytes:
    a, b, c, d = sorted(_place(random, data) for _ in range(4))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _replaced(
    random: Random, data: bytes, pattern: re.Pattern[bytes], by: Callable[[re.Match[bytes]], bytes]
) -> bytes:
    found = list(pattern.finditer(data))
    for match in sorted(
        random.sample(found, min(len(found), random.choice((1, 1, 2, 9)))), key=lambda m: -m.start()
    ):
        data = data[: match.start()] + by(match) + data[match.end() :]
    return data


def numbers(random: Random, data: bytes) -> bytes:
    """Numbers in text replaced by others, or by what is none."""
    return _replaced(random, data, _NUMBER, lambda _: random.choice(NUMBERS).encode())


def words(random: Random, data: bytes) -> bytes:
    """Words replaced by strange ones or by other words of the file."""
    known = _WORD.findall(data[:20_000]) or [b"x"]
    return _replaced(
        random, data, _WORD, lambda _: random.choice(WORDS if random.random() < 0.5 else known)
    )


def lines(random: Random, data: bytes) -> bytes:
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
        rows[first:first] = [
            random.choice((b"", b"# a comment", b"comment x", b"\t"))
        ] * random.choice((1, 500))
    elif act == 4:
        return random.choice((b"\r\n", b"\r", b"\n\n", b" \\\n", b"\x85", b" ")).join(rows)
    elif act == 5:
        rows[first] += b" " + rows[second]
    else:
        return (
            b"\xef\xbb\xbf" + data
            if random.random() < 0.5
            else data.decode("latin-1").encode("utf-16")
        )
    return b"\n".join(rows)


ANY: tuple[Mutation, ...] = (
    *(bits, overwritten, packed_numbers, inserted, deleted, doubled, truncated, extended, swapped),
    *(numbers, words, lines),
)
"""For every file."""

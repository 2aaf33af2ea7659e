"""Regular files, bounded decompression, and arrays of NumPy and GIFTI."""

import base64
import errno
import gzip
import io
import os
import socket
import zlib
from pathlib import Path

import nibabel
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.testing import assert_array_equal

from abfm.errors import one_line
from abfm.reading import array_from, inflated, open_regular, read_bytes, read_gifti
from tests.core.reading.hostile import bomb, gifti, npy, npy_of
from tests.messages import raises


def test_special_files_are_refused_without_waiting(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "circle").symlink_to("circle")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        for name, kind in (
            *(("pipe", "pipe"), ("link", "pipe"), ("socket", "socket")),
            *(("/dev/zero", "device"), ("/dev/urandom", "device"), (".", "directory")),
            *(("none", ""), ("none\0", ""), ("a" * 300, ""), ("circle", "")),
        ):
            with raises(OSError, kind) as caught:
                read_bytes(name)
            assert kind in caught.value.strerror


def test_file_replaced_by_a_pipe_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a").touch()
    os.mkfifo(tmp_path / "pipe")
    plain = os.stat(tmp_path / "a")
    monkeypatch.setattr(os, "stat", lambda _: plain)
    with raises(OSError):
        read_bytes(tmp_path / "pipe")


def test_files_are_read_up_to_a_size(tmp_path):
    (tmp_path / "a").write_bytes(b"\r\n\0whole")
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "a") == read_bytes(tmp_path / "link") == b"\r\n\0whole"
    (tmp_path / "a").write_bytes(bytes(100))
    with raises(OSError, 100, 99) as caught:
        read_bytes(tmp_path / "a", size_max=99)
    assert caught.value.errno == errno.EFBIG
    with open_regular(tmp_path / "a", size_max=100) as file:
        assert file.read() == bytes(100)


@pytest.mark.parametrize("packed", [gzip.compress, zlib.compress])
def test_data_are_decompressed_up_to_a_size(packed):
    content = os.urandom(1000) + bytes(9000)
    data = packed(content)
    assert inflated(data) == inflated(data, size_max=10_000) == content
    with raises(ValueError, 9999):
        inflated(data, size_max=9999)
    damaged = bytearray(data)
    damaged[len(data) // 2] ^= 1
    for bad in (data[:1], data[:10], data[:-1], bytes(damaged)):
        with raises(ValueError):
            inflated(bad)


def test_decompression_bomb_is_refused():
    with raises(ValueError, 67108864):
        inflated(gzip.compress(bytes(80 << 20), 1))


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (ValueError("a\n\tb\x1b[31m\u202e"), "a b?[31m?"),
        (MemoryError(), "MemoryError"),
        (FileNotFoundError(2, "No such file", "/a/b"), "No such file"),
        (Path("/a\nb/\udcff"), "/a b/?"),
        (ValueError("x" * 1000), "x" * 147 + "..." + "x" * 50),
        ("y" * 200, "y" * 200),
    ],
)
def test_one_line_shortens_messages(given, line):
    assert one_line(given) == line


def saved(array, version=1):
    file = io.BytesIO()
    np.lib.format.write_array(file, array, version=(version, 0))
    return file.getvalue()


kinds = arrays.integer_dtypes() | arrays.unsigned_integer_dtypes() | arrays.floating_dtypes()
kinds |= arrays.boolean_dtypes() | arrays.complex_number_dtypes() | arrays.unicode_string_dtypes()


@settings(max_examples=100)
@given(
    array=arrays.arrays(kinds, arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)),
    version=st.sampled_from([1, 2, 3]),
    turned=st.booleans(),
)
def test_numpy_arrays_round_trip(array, version, turned):
    array = np.asfortranarray(array) if turned else array
    found = array_from(saved(array, version))
    assert_array_equal(found, array, strict=True)
    assert found.flags.writeable
    assert found.flags.f_contiguous == array.flags.f_contiguous


def test_headers_of_other_writers_are_read():
    expected = np.arange(6.0).reshape(2, 3)
    for header in (
        "{'shape': (2, 3), 'fortran_order': False, 'descr': '<f8'}",
        '{"descr":"<f8","fortran_order":False,"shape":(2,3)}',
        "{'descr': '<f8', 'fortran_order': False, 'shape': (2L, 3L), }",
        "{'descr': 'f8', 'fortran_order': False, 'shape': (2, 3,), }" + " " * 3000,
    ):
        assert_array_equal(array_from(npy(header, expected.tobytes(), 2)), expected)


def described(**changes):
    entries = {"descr": "'<f8'", "fortran_order": "False", "shape": "(1,)"} | changes
    text = ", ".join(f"'{name}': {value}" for name, value in entries.items())
    return npy("{" + text + ", }", bytes(8))


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", ("header",)),
        (b"PK\x03\x04" * 9, ()),
        (b"\x93NUMPY\x04\x00", (1, 2, 3)),
        (b"\x93NUMPY\x01\x00", ("header",)),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xffabc", ("header",)),
        (npy("{" * 5000), ("header",)),
        (npy("[" * 5000), ("header",)),
        (npy_of("(1,,2)", data=bytes(16)), ("header",)),
        (npy_of("(2)(", data=bytes(16)), ("header",)),
        (npy_of("3", data=bytes(24)), ("header",)),
        (described(fortran_order="None"), ("header",)),
        (described(a="()"), ("header",)),
        (npy_of("(10000000000000,)"), (80000000000000,)),
        (npy_of("(6442450944,)", data=bytes(8)), ("size", 8)),
        (npy_of("(1,)", data=bytes(9)), (9,)),
        (npy_of("(-1,)"), (-1, -8)),
        (npy_of("(-1, -1)", data=bytes(8)), (-1,)),
        (npy_of("(99999999999999999999999,)"), ("size",)),
        (npy_of("(0, 999999999999999999, 999999999999999999)"), ()),
        (npy_of("(3,)", "|O", bytes(24)), ()),
        (npy_of("(999999999,)", "<U0"), ()),
        (npy_of("(1,)", "<U99999999999"), ("header",)),
        (npy_of("(1,)", "<f7", bytes(7)), ("header",)),
        (npy_of("(1,)", "|V8", bytes(8)), ()),
        (npy_of("(1,)", "<M8[s]", bytes(8)), ()),
        (described(descr="[('a', '<f8')]"), ()),
        (npy_of("(2,)", "|b1", b"\x01\x02"), ("boolean", 0, 1)),
    ],
)
def test_invalid_npy_headers_are_refused(content, named):
    with raises(ValueError, *named, recorded=False) as caught:  # some messages are those of NumPy
        array_from(content)
    assert len(str(caught.value)) < 300


NINE = np.arange(9, dtype="<f4")


@pytest.mark.parametrize("encoding", ["ASCII", "B64BIN", "B64GZ"])
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["float32", "int32", "uint8"])
def test_gifti_agrees_with_nibabel(tmp_path, encoding, endian, order, kind):
    random = np.random.default_rng(0)
    arrays = [
        nibabel.gifti.GiftiDataArray(
            (100 * random.random(shape)).astype(kind),
            intent=intent,
            datatype=f"NIFTI_TYPE_{kind.upper()}",
            encoding=f"GIFTI_ENCODING_{encoding}",
            endian=endian,
            ordering=order,
        )
        for shape, intent in (((7, 3), "NIFTI_INTENT_POINTSET"), ((5,), "NIFTI_INTENT_SHAPE"))
    ]
    name = "a.gii" if kind == "uint8" else "a.gii.gz"
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), tmp_path / name)
    found, expected = read_gifti(tmp_path / name).arrays, nibabel.load(tmp_path / name).darrays
    assert [array.intent for array in found] == ["NIFTI_INTENT_POINTSET", "NIFTI_INTENT_SHAPE"]
    for array, other in zip(found, expected, strict=True):
        assert array.values.dtype == kind
        assert_array_equal(array.values, other.data)


def test_gifti_external_file_is_read(tmp_path):
    def external(name, offset="4"):
        more = f'ExternalFileName="{name}" ExternalFileOffset="{offset}"'
        (tmp_path / "a.gii").write_bytes(gifti("", encoding="ExternalFileBinary", more=more))
        [array] = read_gifti(tmp_path / "a.gii").arrays
        return array.values.tolist()

    (tmp_path / "a.bin").write_bytes(NINE.tobytes())
    os.mkfifo(tmp_path / "pipe")
    assert external("a.bin") == [1, 2, 3]
    outside = str(tmp_path.parent / "b.bin"), "../b.bin"
    for name, offset, named in (
        *(("a.bin", "28", (8, 12)), ("a.bin", "-4", ())),
        *((name, "0", ()) for name in ("/dev/zero", "pipe", "none", ".")),
        *((name, "0", ("folder",)) for name in outside),
    ):
        (tmp_path.parent / "b.bin").write_bytes(NINE.tobytes())
        with raises((OSError, ValueError), *named):
            external(name, offset)
    assert external(str(tmp_path / "a.bin")) == external("no/../a.bin") == [1, 2, 3]


OUTSIDE = b'<!DOCTYPE GIFTI SYSTEM "http://www.nitrc.org/frs/download.php/115/gifti.dtd">'


def test_gifti_external_doctype_is_accepted(tmp_path):
    start, rest = gifti("1 2 3").split(b"?>")
    (tmp_path / "a.gii").write_bytes(start + b"?>" + OUTSIDE + rest)
    [array] = read_gifti(tmp_path / "a.gii").arrays
    assert array.values.tolist() == [1, 2, 3]


ONE_DIMENSION = 'Dimensionality="1" Dim0="{}"'
LARGE = ONE_DIMENSION.format(4000000000)

BOMB = base64.b64encode(bomb(65 << 20)).decode()
PACKED = base64.b64encode(zlib.compress(NINE.tobytes())).decode()


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", ("empty",)),
        (bytes(100), ("XML",)),
        (gifti("1 2 3")[:-20], ()),
        (b"<a><GIFTI/></a>", ("GIFTI",)),
        (b'<!DOCTYPE GIFTI [<!ENTITY a "aaaa">]><GIFTI>&a;</GIFTI>', ("<!DOCTYPE",)),
        (gifti("1 2 3", LARGE), ()),
        (gifti(PACKED, LARGE, "GZipBase64Binary"), ()),
        (gifti("", LARGE, "ExternalFileBinary", 'ExternalFileName="a"'), ()),
        (gifti(BOMB, ONE_DIMENSION.format(1000), "GZipBase64Binary"), (4000,)),
        (gzip.compress(bytes(65 << 20), 1), (67108864,)),
        (gifti(PACKED, ONE_DIMENSION.format(10), "GZipBase64Binary"), (36, 40)),
        (gifti(PACKED, ONE_DIMENSION.format(8), "GZipBase64Binary"), (32,)),
        (gifti("AAAA", encoding="Base64Binary"), (3, 12)),
        (gifti("A", encoding="Base64Binary"), ("base64",)),
        (gifti("1 2"), (3, 2)),
        (gifti("1 2 x"), ()),
        (gifti("1 2 3", ""), (0,)),
        (gifti("1 2 3", 'Dimensionality="9999999"'), (1, 6)),
        (gifti("1 2 3", ONE_DIMENSION.format(-3)), (-3, "Dim0")),
        (gifti("1 2 3", 'Dimensionality="1"'), ("Dim0",)),
        (gifti("1 2 3", encoding="x" * 1000), ()),
        (b'<!DOCTYPE GIFTI [<!ATTLIST MD a CDATA "aaaa">]><GIFTI><MD/></GIFTI>', ("<!DOCTYPE",)),
        (OUTSIDE.replace(b">", b"[]>") + b"<GIFTI/>", ("<!DOCTYPE",)),
        (b'<?xml version="1.0" encoding="foo"?><GIFTI/>', ("encoding", "foo", "UTF-8")),
        (b'<?xml version="1.0" encoding="utf-7"?><GIFTI/>', ("encodings",)),
    ],
)
def test_invalid_gifti_arrays_are_refused(tmp_path, content, named):
    (tmp_path / "a.gii").write_bytes(content)
    with raises(ValueError, *named) as caught:
        read_gifti(tmp_path / "a.gii")
    assert len(str(caught.value)) < 300

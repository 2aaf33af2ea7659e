"""Data arrays of GIFTI files: as nibabel reads them, and none that does not fit its file."""

import base64
import gzip
import os
import zlib

import nibabel
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm.reading import gifti_arrays
from tests.core.reading.hostile import gifti, gifti_bomb, one_byte_changed

NINE = np.arange(9, dtype="<f4")


@pytest.mark.parametrize("encoding", ["ASCII", "B64BIN", "B64GZ"])
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["float32", "int32", "uint8"])
def test_what_nibabel_writes_is_read_as_nibabel_reads_it(tmp_path, encoding, endian, order, kind):
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
    found, expected = gifti_arrays(tmp_path / name), nibabel.load(tmp_path / name).darrays
    assert [array.intent for array in found] == ["NIFTI_INTENT_POINTSET", "NIFTI_INTENT_SHAPE"]
    for array, other in zip(found, expected, strict=True):
        assert array.values.dtype == kind
        assert_array_equal(array.values, other.data)


def test_values_from_a_file_beside_it(tmp_path):
    def beside(name, offset="4"):
        more = f'ExternalFileName="{name}" ExternalFileOffset="{offset}"'
        (tmp_path / "a.gii").write_bytes(gifti("", encoding="ExternalFileBinary", more=more))
        [array] = gifti_arrays(tmp_path / "a.gii")
        return array.values.tolist()

    (tmp_path / "a.bin").write_bytes(NINE.tobytes())
    os.mkfifo(tmp_path / "pipe")
    assert beside("a.bin") == [1, 2, 3]
    for name, offset, words in (
        ("a.bin", "28", "has 8 bytes; expected 12"),
        ("a.bin", "-4", "whole number"),
        ("/dev/zero", "0", "a device"),
        ("pipe", "0", "a pipe"),
        ("none", "0", "No such file"),
        (".", "0", "directory"),
    ):
        with pytest.raises((OSError, ValueError), match=words):
            beside(name, offset)


ONE = 'Dimensionality="1" Dim0="{}"'
LARGE, TOO_MUCH = ONE.format(4000000000), "more than a file of this size may hold"
PACKED = base64.b64encode(zlib.compress(NINE.tobytes())).decode()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no XML, or cut short"),
        (bytes(100), "no XML"),
        (gifti("1 2 3")[:-20], "cut short"),
        (b"<a><GIFTI/></a>", "not GIFTI"),
        (b'<!DOCTYPE GIFTI [<!ENTITY a "aaaa">]><GIFTI>&a;</GIFTI>', "declares entities"),
        (gifti("1 2 3", LARGE), TOO_MUCH),
        (gifti(PACKED, LARGE, "GZipBase64Binary"), TOO_MUCH),
        (gifti("", LARGE, "ExternalFileBinary", 'ExternalFileName="a"'), TOO_MUCH),
        (gifti_bomb(ONE.format(1000)), "hold more than 4000, the most"),
        (gzip.compress(bytes(65 << 20), 1), "hold more than 67108864, the most"),
        (
            gifti(PACKED, ONE.format(10), "GZipBase64Binary"),
            "has 36 bytes; expected 40",
        ),
        (gifti(PACKED, ONE.format(8), "GZipBase64Binary"), "hold more than 32"),
        (gifti("AAAA", encoding="Base64Binary"), "has 3 bytes; expected 12"),
        (gifti("A", encoding="Base64Binary"), "base64"),
        (gifti("1 2"), "an array of 3 numbers has 2"),
        (gifti("1 2 x"), "something else among them"),
        (gifti("1 2 3", ""), "has 0 dimensions"),
        (gifti("1 2 3", 'Dimensionality="9999999"'), "dimensions; expected 1 to 6"),
        (gifti("1 2 3", ONE.format(-3)), "Dim0 '-3'; expected a whole number"),
        (gifti("1 2 3", 'Dimensionality="1"'), "Dim0 ''"),
        (gifti("1 2 3", encoding="x" * 1000), "Encoding 'xxx"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path, content, words):
    (tmp_path / "a.gii").write_bytes(content)
    with pytest.raises(ValueError, match=words) as caught:
        gifti_arrays(tmp_path / "a.gii")
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "content",
    [gifti("1 2 3"), gifti(PACKED, 'Dimensionality="2" Dim0="3" Dim1="3"', "GZipBase64Binary")],
)
def test_one_wrong_byte_gives_arrays_or_is_refused(tmp_path, content):
    for changed in one_byte_changed(content):
        (tmp_path / "a.gii").write_bytes(changed)
        try:
            found = gifti_arrays(tmp_path / "a.gii")
        except (OSError, ValueError):
            continue
        assert all(array.values.size <= 9 for array in found)

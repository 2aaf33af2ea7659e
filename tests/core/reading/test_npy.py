"""Arrays of .npy files: what NumPy writes comes back, and headers fit their files."""

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.testing import assert_array_equal

from abfm.reading import array_from
from tests.core.reading.hostile import npy, npy_of, one_byte_changed


def saved(array, version=1):
    file = io.BytesIO()
    np.lib.format.write_array(file, array, version=(version, 0))
    return file.getvalue()


kinds = st.one_of(
    arrays.integer_dtypes(endianness="?"),
    arrays.unsigned_integer_dtypes(endianness="?"),
    arrays.floating_dtypes(endianness="?"),
    arrays.boolean_dtypes(),
    arrays.complex_number_dtypes(),
    arrays.unicode_string_dtypes(),
)


@settings(deadline=None, max_examples=100)
@given(
    array=arrays.arrays(kinds, arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)),
    version=st.sampled_from([1, 2, 3]),
    turned=st.booleans(),
)
def test_what_numpy_writes_comes_back(array, version, turned):
    array = np.asfortranarray(array) if turned else array
    found = array_from(saved(array, version))
    assert_array_equal(found, array, strict=True)
    assert found.flags.writeable
    assert found.flags.f_contiguous == array.flags.f_contiguous


def test_headers_of_other_writers_are_read():
    data = np.arange(6.0).tobytes()
    expected = np.arange(6.0).reshape(2, 3)
    for header in (
        "{'shape': (2, 3), 'fortran_order': False, 'descr': '<f8'}",
        '{"descr":"<f8","fortran_order":False,"shape":(2,3)}',
        "{'descr': '<f8', 'fortran_order': False, 'shape': (2L, 3L), }",
        "{'descr': 'f8', 'fortran_order': False, 'shape': (2, 3,), }" + " " * 3000,
    ):
        assert_array_equal(array_from(npy(header, data, version=2)), expected)


def described(**changes):
    entries = {"descr": "'<f8'", "fortran_order": "False", "shape": "(1,)"} | changes
    text = ", ".join(f"'{name}': {value}" for name, value in entries.items())
    return npy("{" + text + ", }", bytes(8))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "header is damaged"),
        (b"PK\x03\x04" * 9, "magic string is not correct"),
        (b"\x93NUMPY\x04\x00", "version 1, 2 or 3"),
        (b"\x93NUMPY\x01\x00", "header is damaged"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xffabc", "header is damaged"),
        (npy("{" * 5000), "header is damaged"),
        (npy("[" * 5000), "header is damaged"),
        (npy_of("(1,,2)", data=bytes(16)), "header is damaged"),
        (npy_of("(2)(", data=bytes(16)), "header is damaged"),
        (npy_of("3", data=bytes(24)), "header is damaged"),
        (described(fortran_order="None"), "header is damaged"),
        (described(a="()"), "header is damaged"),
        (npy_of("(10000000000000,)"), "80000000000000"),
        (npy_of("(6442450944,)", data=bytes(8)), "size is not what its header says: 8 bytes"),
        (npy_of("(1,)", data=bytes(9)), "9 bytes follow"),
        (npy_of("(-1,)"), r"of shape \(-1,\) have -8"),
        (npy_of("(-1, -1)", data=bytes(8)), r"of shape \(-1, -1\)"),
        (npy_of("(99999999999999999999999,)"), "size is not"),
        (npy_of("(0, 999999999999999999, 999999999999999999)"), "array"),
        (npy_of("(3,)", "|O", bytes(24)), "its type is object"),
        (npy_of("(999999999,)", "<U0"), "its type is"),
        (npy_of("(1,)", "<U99999999999"), "header is damaged"),
        (npy_of("(1,)", "<f7", bytes(7)), "header is damaged"),
        (npy_of("(1,)", "|V8", bytes(8)), "its type is"),
        (npy_of("(1,)", "<M8[s]", bytes(8)), "its type is"),
        (described(descr="[('a', '<f8')]"), "its type is"),
        (npy_of("(2,)", "|b1", b"\x01\x02"), "boolean is neither 0 nor 1"),
    ],
)
def test_headers_that_do_not_fit_are_refused(content, words):
    with pytest.raises(ValueError, match=words) as caught:
        array_from(content)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "array", [np.arange(12.0).reshape(3, 4), np.array(True), np.array("text"), np.arange(300)]
)
def test_one_wrong_byte_gives_an_array_of_the_same_size_or_is_refused(array):
    content = saved(array)
    refused = 0
    for changed in one_byte_changed(content, 128):
        try:
            found = array_from(changed)
        except ValueError:
            refused += 1
        else:
            assert found.nbytes == array.nbytes
    assert refused > 50

"""Conversion of user input to arrays of real numbers."""

import warnings
from collections import UserList

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm import FunctionError
from abfm.numerics.real_numbers import real_numbers
from tests.messages import raises
from tests.shapes import icosphere

X = icosphere(1).vertices[:, 0]
COUNT = len(X)


class Refusing:
    """An object whose conversion to an array fails."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("on another device")


NO_NUMBERS = {
    "text": "abc",
    "texts": ["1"] * COUNT,
    "ragged": [[1.0, 2.0], [3.0]],
    "objects": np.array([{}] * COUNT, dtype=object),
    "complex": X + 1j,
    "dates": np.full(COUNT, "2020", dtype="M8[D]"),
    "records": np.zeros(COUNT, dtype=[("a", float)]),
    "generator": (x for x in X),
    "huge": [10**400] * COUNT,
    "refusing": Refusing(),
    "mapping": {"a": 1.0},
    "none": [None] * COUNT,
}


@pytest.mark.parametrize(
    "given", [[1, 2], (1.0, 2.0), UserList([1.0, 2.0]), np.float32([1, 2]), np.ma.array([1, 2])]
)
def test_array_like_inputs_become_float64(given):
    found = real_numbers(given, "f")
    assert found.dtype == np.float64
    assert_array_equal(found, [1.0, 2.0])


@pytest.mark.parametrize("given", NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_inputs_without_real_numbers_give_one_short_line(given):
    with raises(FunctionError) as refused:
        real_numbers(given, "f", FunctionError)
    assert len(str(refused.value)) < 200


def test_signalling_nan_gives_no_warning():
    single = np.array([0x7FA00000, 0x3F800000], dtype=np.uint32).view(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = real_numbers(single, "values")
    assert np.isnan(found[0])
    assert found[1] == 1

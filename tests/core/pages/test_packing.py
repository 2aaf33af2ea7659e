"""Packed arrays: integers are restored exactly, values and points within half a step."""

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from abfm.pages.packing import LEVELS, NO_VALUE, Store, quantized, quantized_points
from tests.shapes import ellipsoid


def unpacked(store, entry):
    """Return an array of a store's text, unpacked as in `packing.js`."""
    data = zlib.decompress(base64.b64decode(store.text()))
    rows, columns, size = (entry[name] for name in ("rows", "columns", "bytes"))
    count = rows * columns
    planes = np.frombuffer(data, np.uint8, count * size, entry["offset"]).reshape(size, count)
    parts = [planes[byte].astype(np.uint64) << np.uint64(8 * byte) for byte in range(size)]
    changes = sum(parts, np.zeros(count, np.uint64)).reshape(rows, columns)
    return (np.cumsum(changes, axis=0) % np.uint64(2 ** (8 * size))).astype(f"u{size}")


KINDS = st.sampled_from([np.uint8, np.uint16, np.uint32])
INTEGERS = KINDS.flatmap(lambda kind: arrays(kind, array_shapes(min_dims=2, max_dims=2)))
LARGE = st.floats(-1e300, 1e300, allow_subnormal=False)
NUMBERS = LARGE | st.sampled_from([np.nan, np.inf, -np.inf])


@given(st.lists(INTEGERS, min_size=1, max_size=3))
def test_integers_are_restored(given):
    store = Store()
    entries = [store.add(each) for each in given]
    for entry, expected in zip(entries, given, strict=True):
        np.testing.assert_array_equal(unpacked(store, entry), expected)


def test_single_precision_numbers_are_restored():
    store, numbers = Store(), np.array([[0.1, -1e30], [np.pi, 0.0]], dtype=np.float32)
    entry = store.add(numbers)
    np.testing.assert_array_equal(unpacked(store, entry).view(np.float32), numbers)


@given(arrays(float, array_shapes(min_dims=2, max_dims=2), elements=NUMBERS))
def test_values_are_restored_within_half_a_step(values):
    found, known = quantized(values), np.isfinite(values)
    np.testing.assert_array_equal(found.numbers == NO_VALUE, ~known)
    if known.any():
        integers = found.numbers[known].astype(float)
        assert integers.max() <= LEVELS
        back = found.minimum + found.step * integers
        low, high = values[known].min(), values[known].max()
        half = (high / 2 - low / 2) / LEVELS
        rounding = 1e-12 * max(abs(low), abs(high)) + 1e-300
        assert np.abs(back - values[known]).max() <= half + rounding


def test_constant_and_unknown_values_are_packed():
    np.testing.assert_array_equal(quantized(np.full((2, 3), 7.0)).numbers, 0)
    np.testing.assert_array_equal(quantized(np.full((2, 3), np.nan)).numbers, NO_VALUE)
    found = quantized([[1e9, 1e9 + 1]])  # a small difference of large numbers
    np.testing.assert_array_equal(found.numbers, [[0, LEVELS]])
    assert (found.position(1e9), found.position(1e9 + 1)) == pytest.approx((0, LEVELS))


def test_points_are_restored_within_half_a_step():
    points = ellipsoid(3, 1.0, 0.7, 0.2).vertices
    for each in (points, points * [1.0, 1.0, 0.0]):  # also points in a plane
        numbers, low, steps = quantized_points(each)
        half_step = np.ptp(each, axis=0).max() / 65535 / 2
        assert np.abs(low + steps * numbers - each).max() <= 1.001 * half_step

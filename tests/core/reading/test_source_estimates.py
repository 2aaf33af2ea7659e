"""MNE source estimates (.stc): round trips, and errors for damaged files."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import ResultError
from abfm.io import write_stc
from abfm.reading import read_stc
from tests.messages import raises

BIG = 2**32 - 1


def by_hand(tmin, tstep, vertices, values):
    """Return the bytes of a file in the format of the MNE manual."""
    head = struct.pack(f">ffI{len(vertices)}I", tmin, tstep, len(vertices), *vertices)
    return head + struct.pack(f">I{values.size}f", len(values), *values.ravel())


COMPLETE_FILE = by_hand(-100, 5, [3, 0, 7], np.arange(6.0).reshape(2, 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stc")


def test_file_of_the_manual_is_read(folder):
    (folder / "a-lh.stc").write_bytes(COMPLETE_FILE)
    found = read_stc((folder / "a-lh.stc").read_bytes())
    assert_array_equal(found.values.T, np.arange(6.0).reshape(2, 3), strict=True)
    assert found.vertices.tolist() == [3, 0, 7]
    assert_allclose(found.times, [-0.1, -0.095], rtol=1e-15)
    write_stc(folder / "b-lh.stc", found.values.T, found.vertices, found.times)
    assert (folder / "b-lh.stc").read_bytes() == COMPLETE_FILE


@given(seed=st.integers(0, 2**32 - 1), samples=st.integers(1, 5), count=st.integers(1, 9))
@settings(max_examples=30)
def test_source_estimates_round_trip(folder, seed, samples, count):
    random = np.random.default_rng(seed)
    values = random.normal(size=(samples, count)).astype(np.float32).astype(np.float64)
    vertices = np.sort(random.choice(10_000, count, replace=False))
    times = random.uniform(-1, 1) + random.uniform(0.01, 3) * np.arange(samples)
    write_stc(folder / "c-rh.stc", values, vertices, times)
    found = read_stc((folder / "c-rh.stc").read_bytes())
    assert_array_equal(found.values.T, values)
    assert_array_equal(found.vertices, vertices)
    assert_allclose(found.times, times, atol=1e-6)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", (0,)),
        (struct.pack(">ffI", 0, 1, BIG), (4294967295,)),
        (struct.pack(">ffIII", 0, 1, 1, 0, BIG), (4294967295, 1)),
        (struct.pack(">ffII", 0, 1, 0, 4), (4, 0)),
        (struct.pack(">ffIII", 0, 1, 1, 0, 0), (0, 1)),
        (by_hand(0, 1, [4, 4], np.zeros((1, 2))), ()),
        (by_hand(0, 0, [4], np.zeros((1, 1))), (0,)),
        (by_hand(np.nan, 1, [4], np.zeros((1, 1))), ()),
        (COMPLETE_FILE + b"\0", (24, 25)),
    ],
)
def test_inconsistent_files_are_refused(folder, content, named):
    (folder / "d.stc").write_bytes(content)
    with raises(ValueError, *named):
        read_stc((folder / "d.stc").read_bytes())


def test_unreadable_files_are_not_written(folder):
    values, vertices = np.zeros((3, 2)), np.arange(2)
    with raises(ResultError, "-lh.stc", "-rh.stc"):
        write_stc(folder / "x.stc", values, vertices, [0, 1, 2])
    with raises(ResultError):
        write_stc(folder / "x-lh.stc", values, vertices, [0, 1, 3])
    with raises(ResultError, "(3, 2)", "(3, 1)"):
        write_stc(folder / "x-lh.stc", values, vertices[:1], [0, 1, 2])
    assert not (folder / "x-lh.stc").exists()

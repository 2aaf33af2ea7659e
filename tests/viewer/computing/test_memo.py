"""What was made last is kept while what it is made of stays the same."""

from __future__ import annotations

import numpy as np
import pytest

from abfm_viewer.computing.memo import Memo, same

VALUES = np.zeros(3)


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (1, 1.0, True),
        ("a", "b", False),
        (None, 0, False),
        (VALUES, VALUES, True),
        (VALUES, VALUES.copy(), False),
        (VALUES, 0.0, False),
        ((1, (VALUES, "a")), (1, (VALUES, "a")), True),
        ((1, (VALUES, "a")), (1, (VALUES.copy(), "a")), False),
        ((1, 2), (1, 2, 3), False),
        ((1,), 1, False),
        (float("nan"), float("nan"), False),
    ],
)
def test_arrays_are_the_same_by_identity_and_other_things_by_value(one, other, expected):
    assert same(one, other) is expected


def test_a_value_is_made_again_only_when_what_it_is_made_of_changes():
    memo, made = Memo[list[int]](), []

    def make():
        made.append(1)
        return [len(made)]

    first = memo.get((VALUES, 1), make)
    assert memo.get((VALUES, 1), make) is first == [1]
    assert memo.get((VALUES.copy(), 1), make) == [2]
    assert memo.get((VALUES, 2), make) == [3]
    assert memo.get((VALUES, 1), make) == [4]  # only the latest is kept


def test_what_could_not_be_made_leaves_the_value_before():
    memo = Memo[int]()
    memo.get((1,), lambda: 1)
    with pytest.raises(ZeroDivisionError):
        memo.get((2,), lambda: 1 // 0)
    assert memo.get((1,), lambda: 2) == 1
    assert memo.get((3,), lambda: None) is None
    assert memo.get((3,), lambda: 4) is None

"""Blending without a flow."""

import numpy as np
from numpy.testing import assert_array_equal

from abfm.baselines import linear_blend


def test_linear_blend_goes_straight_from_source_to_target() -> None:
    f, g = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0, 2.0], [0.0, -4.0]])
    assert_array_equal(linear_blend(f, g, 0.0, 2.0), f)
    assert_array_equal(linear_blend(f, g, 2.0, 2.0), g)
    assert_array_equal(linear_blend(f, g, 0.5, 2.0), 0.75 * f + 0.25 * g)

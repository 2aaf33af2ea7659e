"""Where on a slider a value is."""

from __future__ import annotations

import pytest

from abfm_viewer.widgets.slider_scale import share_of, value_at


@pytest.mark.parametrize(
    ("low", "high", "log", "values"),
    [
        (0.0, 4.0, False, (0.0, 1.0, 4.0)),
        (1e-4, 1e4, True, (1e-4, 0.02, 1e4)),
        (0.0, 1.0, True, (0.0, 1e-6, 1e-4, 0.5, 1.0)),
    ],
)
def test_a_place_and_its_value_belong_together(low, high, log, values):
    shares = [share_of(value, low, high, log) for value in values]
    assert (shares[0], shares[-1]) == (0, 1)
    assert shares == sorted(shares)
    for value, share in zip(values, shares, strict=True):
        assert value_at(share, low, high, log) == pytest.approx(value, rel=1e-9)


def test_a_logarithmic_slider_from_0_has_a_stretch_for_0_and_nothing_below_its_decades():
    assert value_at(0.01, 0, 1, True) == 0
    assert value_at(0.05, 0, 1, True) == pytest.approx(1e-6)
    assert 0 < share_of(1e-9, 0, 1, True) < 0.1

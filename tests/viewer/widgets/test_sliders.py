"""Where on a slider a value is."""

from __future__ import annotations

import pytest

from abfm_viewer.widgets.slider_range import Range


@pytest.mark.parametrize(
    ("ends", "values"),
    [
        (Range(0.0, 4.0), (0.0, 1.0, 4.0)),
        (Range(1e-4, 1e4, log=True), (1e-4, 0.02, 1e4)),
        (Range(0.0, 1.0, log=True), (0.0, 1e-6, 1e-4, 0.5, 1.0)),
    ],
)
def test_a_place_and_its_value_belong_together(ends, values):
    shares = [ends.share_of(value) for value in values]
    assert (shares[0], shares[-1]) == (0, 1)
    assert shares == sorted(shares)
    for value, share in zip(values, shares, strict=True):
        assert ends.value_at(share) == pytest.approx(value, rel=1e-9)


def test_a_logarithmic_slider_from_0_has_a_stretch_for_0_and_nothing_below_its_decades():
    ends = Range(0, 1, log=True)
    assert ends.value_at(0.01) == 0
    assert ends.value_at(0.05) == pytest.approx(1e-6)
    assert 0 < ends.share_of(1e-9) < 0.1

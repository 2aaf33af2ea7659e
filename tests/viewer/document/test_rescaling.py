import numpy as np
import pytest

from abfm.functions import function, parse
from abfm_viewer.document.rescaling import rescaled, smoothed
from tests.shapes import icosphere

MESH = icosphere(2)


@pytest.mark.parametrize("spec", ["coordinate:x", "scaled:-3,offset=2(coordinate:x)"])
@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-1e6, 1e6), (3.0, 3.001), (-2e-7, 5e-6)])
def test_rescaled_source_has_the_range_of_the_target(spec, low, high):
    target = np.linspace(low, high, 50)
    source = function(MESH, spec)
    found = rescaled(spec, source, target)
    values = function(MESH, found)
    slack = 1e-4 * (high - low)
    np.testing.assert_allclose([values.min(), values.max()], [low, high], rtol=0, atol=slack)
    assert str(parse(found).function) == "coordinate:x"  # scaling again changes nothing
    assert rescaled(found, values, target) == found
    assert np.corrcoef(values, source)[0, 1] == pytest.approx(1)


def test_factor_and_offset_are_short():
    """Rounding errors of the range would be shown as an offset such as -2.1e-17."""
    values = np.array([1e-17, 0.5, 2.0])
    assert rescaled("file:a.npy", values, np.linspace(0, 1, 9)) == "scaled:0.5(file:a.npy)"
    found = rescaled("file:a.npy", np.array([-0.551, 1.0]), np.array([-0.882, 1.0]))
    assert found == "scaled:1.213411,offset=-0.213411(file:a.npy)"


def test_constant_functions_are_not_rescaled():
    source = function(MESH, "coordinate:x")
    assert rescaled("coordinate:x", source, np.full(3, 2.0)) == "coordinate:x"
    assert rescaled("expression:2", np.full(3, 2.0), source) == "expression:2"


def test_two_smoothings_are_combined():
    """The times of two heat flows, which are squares of lengths, add up."""
    assert smoothed("hks", 0.03) == "smoothed:0.03(hks)"
    assert smoothed("smoothed:0.03(hks)", 0.04) == "smoothed:0.05(hks)"
    assert smoothed("scaled:2(hks)", 0.04) == "smoothed:0.04(scaled:2.0(hks))"

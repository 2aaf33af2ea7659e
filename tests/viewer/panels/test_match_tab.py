from dataclasses import replace

import numpy as np
import pytest

from abfm.parameters import FIELDS
from abfm_viewer.appearance import axes
from abfm_viewer.document.document import RunRecord
from abfm_viewer.panels import energy, trade_off
from abfm_viewer.panels import parameters as panel
from abfm_viewer.widgets import plots
from abfm_viewer.widgets.widget_record import Range


def test_panel_has_every_parameter_with_a_tooltip():
    assert sorted(panel._PARAMETER_TEXTS) == sorted(FIELDS)
    for name, about in panel._PARAMETER_TEXTS.items():
        assert all(word in panel._tip(name) for word in ("Default", "paper", "Bad result?"))
        value = panel._AUTO[name].first if name in panel._AUTO else FIELDS[name].default
        assert name in panel._CHOICES or 0 <= about.slider.share_of(value) <= 1


def run(stages, vertices=(), reaches=(), restarts=()):
    energies, course = np.ones((len(stages), 3)), (np.array(vertices, int), np.array(reaches))
    return RunRecord(energies, np.array(stages), restarts, 0.1, "", *course)


@pytest.mark.parametrize(
    ("marked", "stages", "meshes"),
    [
        (run([0, 0, 1, 2, 2, 3], [600, 600, 600, 2500, 2500, 2500], [0.0] * 6), [2, 5], [3]),
        (run([0, 1, 0, 1], [600, 2500, 600, 2500], [0.0] * 4, (2,)), [2], [1, 3]),
        (run([0, 0, 1]), [2], []),
    ],
)
def test_stages_and_finer_meshes_have_separate_lines(marked, stages, meshes):
    assert energy.starts(marked) == (stages, meshes)


def test_sections_begin_with_changes_attempts_and_refinements():
    record = run([0, 0, 1, 0, 0, 1, 2, 3], [150] * 6 + [600, 2400], [0.0] * 8, (3, 8))
    assert energy.sections(record, 600) == {0: "match", 3: "changed", 7: "refined"}
    tried = replace(record, attempts=np.array([1, 1, 2, 1, 1, 2, 1, 1]))
    assert energy.sections(tried, 600) == {
        0: "attempt 1",
        2: "attempt 2",
        3: "changed",
        5: "attempt 2",
        6: "attempt 1",
        7: "refined",
    }
    assert energy.sections(run([0, 0, 1]), 600) == {0: "match"}  # from a result file
    assert energy.sections(run([], restarts=(0,)), 600) == {0: "match"}


def test_smallest_residual_decreases_until_a_change():
    """The curve never rises before a change; unknown residuals are computed from the energy."""
    record = run([0, 0, 1, 1, 0, 0], restarts=(4, 6))
    record = replace(record, residual=0.4, residuals=np.array([1, 0.6, 0.7, 0.5, 0.9, 0.3]))
    assert list(record.best_residuals) == [1, 0.6, 0.6, 0.5, 0.9, 0.4]
    energies = np.array([[9, 9, 16], [9, 9, 4], [9, 9, 900], [9, 9, 225]])
    unknown = replace(run([0, 0, 1, 1]), energies=energies.astype(float))  # ends at 0.1
    np.testing.assert_allclose(unknown.residual_curve, [0.4, 0.2, 0.2, 0.1])
    assert len(run([]).best_residuals) == 0


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.04, 1.2, [0.1, 0.3, 1]),
        (0.005, 1.2, [0.01, 0.1, 1]),
        (0.3, 0.8, [0.3, 0.4, 0.5, 0.6, 0.8]),
    ],
)
def test_axis_of_residuals_has_round_ticks(low, high, ticks):
    assert axes.share_ticks(low, high) == ticks


@pytest.mark.parametrize(
    ("ends", "factors"),
    [
        ((0, 0.02), [1, 1.005, 1.01]),
        ((0, 0.7), [1, 1.2, 1.4, 1.6]),
        ((1.38, 1.46), [2.65, 2.7, 2.75]),
        ((0, 5.8), [1, 2, 5, 10, 20, 50]),
        ((-0.1, 2.2), [1, 1.5, 2, 3]),
    ],
)
def test_axis_of_areas_has_round_factors(ends, factors):
    ticks, labels = axes.factor_ticks(*ends)
    np.testing.assert_allclose(2 ** np.array(ticks), factors)
    assert labels == [f"×{factor:g}" for factor in factors]


def test_diverged_steps_do_not_stretch_the_axis():
    found = plots.positive(np.array([0.0, np.nan, 0.5, 1e14]))
    np.testing.assert_array_equal(found, [np.nan, np.nan, 0.5, np.nan])


def test_labels_of_ticks_do_not_overlap():
    assert axes.readable_ticks([0, 30, 60, 90, 120], [50] * 5) == [0, 2, 4]
    assert axes.readable_ticks([0, 30, 60], [30, 30, 20]) == [0, 1, 2]


@pytest.mark.parametrize(
    ("areas", "ends"),
    [([0.5, 0.1], (0, 0.5)), ([1.3, np.nan, 1.4], (1.3, 1.4)), ([np.nan], (0, 0.01))],
)
def test_axis_of_areas_begins_at_1_unless_all_are_large(areas, ends):
    assert trade_off.area_range(np.array(areas)) == ends


def test_tooltip_describes_an_iteration():
    coarse_to_fine = run([0, 0, 2], [600, 600, 2500], [0.5, 0.5, 0])
    first = "mesh of 600 vertices, long-range search, stage 1"
    assert energy.stage_text(coarse_to_fine, 0) == first
    assert energy.stage_text(coarse_to_fine, 2) == "mesh of 2,500 vertices, stage 3"
    assert energy.stage_text(run([0, 0, 1]), 2) == "stage 2"  # an iteration before the change


@pytest.mark.parametrize(
    ("ends", "values"),
    [
        (Range(0.0, 4.0), (0.0, 1.0, 4.0)),
        (Range(1e-4, 1e4, log=True), (1e-4, 0.02, 1e4)),
        (Range(0.0, 1.0, log=True), (0.0, 1e-6, 1e-4, 0.5, 1.0)),
    ],
)
def test_slider_positions_and_values_are_inverse(ends, values):
    shares = [ends.share_of(value) for value in values]
    assert (shares[0], shares[-1]) == (0, 1)
    assert shares == sorted(shares)
    for value, share in zip(values, shares, strict=True):
        assert ends.value_at(share) == pytest.approx(value, rel=1e-9)


def test_logarithmic_slider_from_0_has_a_range_for_0():
    """Values below the slider's decades, except 0, are not possible."""
    ends = Range(0, 1, log=True)
    assert ends.value_at(0.01) == 0
    assert ends.value_at(0.05) == pytest.approx(1e-6)
    assert 0 < ends.share_of(1e-9) < 0.1

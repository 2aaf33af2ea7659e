from types import SimpleNamespace
from typing import get_args

import numpy as np

from abfm_viewer.document.comparison import Comparison, ComparisonKind

VALUES = np.arange(10.0).reshape(2, 5, 1)
VALUES[0, 3] = np.nan
AREAS = np.array([0.0, 1.0, np.nan])


def comparison(name="sub-1", kind="difference"):
    population = SimpleNamespace(
        names=[name, "sub-2"],
        fits=np.ones(2, dtype=bool),
        values=VALUES,
        mean_of_others=lambda subject, channel: VALUES[1 - subject, :, channel],
        mean=lambda channel: VALUES[1, :, channel],
        log2_area_deviation=AREAS,
    )
    return Comparison(population, 0, {("own", "mean"): 0}, kind)


def test_long_subject_names_are_abbreviated_in_titles():
    assert comparison().title("source") == "sub-1, transferred"
    long = comparison("sub-001_ses-baseline_hemi-L_space-fsaverage")
    assert long.title("source") == "sub-001_ses-baseline_..., transferred"
    assert long.title("advected") == "sub-001_ses-baseline_... minus the mean"
    assert long.name.endswith("fsaverage")
    assert {comparison(kind=kind).title("error") for kind in get_args(ComparisonKind)} == {"error"}


def test_each_slot_has_its_unknown_values():
    found = comparison()
    assert found.unknown("source", 0).tolist() == [False, False, False, True, False]
    assert found.unknown("advected", 0).tolist() == [False, False, False, True, False]
    assert found.unknown("target", 0) is found.unknown("error", 0) is None
    assert comparison(kind="mean").unknown("advected", 0) is None
    assert comparison(kind="areas").unknown("advected", 0).tolist() == [False, False, True]

"""Which of several ways to solve one problem is told to be best."""

import math

import pytest

from abfm.batch import LedgerEntry, Row, combinations
from abfm.matching.judging.facts import known_numbers
from abfm.outcome import Facts, Outcome
from abfm_viewer.cli.batches.best import best_of
from abfm_viewer.cli.batches.page import page
from abfm_viewer.cli.batches.rows import SummaryRow
from tests.messages import check_message

PROBLEM = {"mesh": "a.off", "source": "coordinate:x", "target": "coordinate:y"}


def swept(*numbers, sigma="0.1", verdicts=None, over=None):
    """Told rows of a sweep over alpha, of what they leave and their mean |log2 J|."""
    alphas = [str(0.01 * 2**i) for i in range(len(numbers))]
    rows = combinations([*PROBLEM.items(), ("sigma", sigma)], over or {"alpha": alphas})
    verdicts = verdicts or ["matched"] * len(numbers)
    return [
        SummaryRow(LedgerEntry(row, "missing"), Facts(Outcome.MISSING, "missing"))
        if each is None
        else SummaryRow(LedgerEntry(row, "done"), facts(verdict, *each))
        for row, each, verdict in zip(rows, numbers, verdicts, strict=True)
    ]


def facts(verdict, residual, log2_area):
    numbers = {"residual": residual, "verified_residual": residual / 2, "folded": 0.0}
    found = known_numbers(numbers | {"log2_area": log2_area})
    return Facts(Outcome(verdict), verdict, numbers=found)


def names(rows, best):
    """Numbers of the closest, of the one that changes areas least, and of those unbeaten."""
    of = {row.entry.row.name: number for number, row in enumerate(rows)}
    told = best.to_dict()
    least = told["areas_change_least"]
    return (
        of[told["closest"]],
        None if least is None else of[least],
        sorted(of[name] for name in best.unbeaten),
    )


def test_the_closest_the_gentlest_and_those_that_none_beats_in_both_are_told():
    rows = swept((0.02, 0.5), (0.03, 0.4), (0.035, 0.45), (0.04, 0.2), (0.05, 0.2), None)
    best = best_of(rows)
    assert names(rows, best) == (0, 3, [0, 1, 3])
    closest, least = best.sentences()
    check_message(closest, "alpha 0.01", "2%", "0.50")
    check_message(least, "alpha 0.08", "4%", "0.20")
    (both,) = best_of(swept((0.02, 0.1), (0.03, 0.4))).sentences()
    check_message(both, "alpha 0.01", "2%", "0.10")


def test_those_that_did_not_reach_their_target_count_only_among_themselves():
    rows = swept((0.02, 0.1), (0.3, 0.05), (0.04, 0.2), verdicts=["not reached"] * 2 + ["nearly"])
    assert names(rows, best_of(rows)) == (2, 2, [2])
    rows = swept((0.4, 0.1), (0.3, 0.2), verdicts=["not reached"] * 2)
    assert names(rows, best_of(rows)) == (1, 0, [0, 1])
    check_message(best_of(rows).sentences()[1], "alpha 0.01", "40%")


def test_equals_are_both_unbeaten_and_what_is_unknown_is_told_of_neither():
    rows = swept((0.02, 0.1), (0.02, 0.1), (0.02, math.nan))
    assert names(rows, best_of(rows)) == (0, 0, [0, 1])
    rows = swept((0.02, math.nan), (0.01, math.nan))
    assert names(rows, best_of(rows)) == (1, None, [])
    assert best_of(rows).sentences() == ["closest: alpha 0.02: 1% left"]
    assert best_of(swept((math.nan, 0.1), (0.1, 0.1))) is None


@pytest.mark.parametrize("sigma", ["0.1", "auto"])
def test_of_measured_functions_closer_is_said_to_be_no_better_where_sigma_is_given(sigma):
    told = best_of(swept((0.2, 0.1), (0.3, 0.2), sigma=sigma, verdicts=["registered"] * 2))
    assert ("noise" in told.sentences()[-1]) == (sigma != "auto")


def test_of_several_problems_and_of_one_way_none_is_best():
    assert best_of([]) is None
    assert best_of(swept((0.02, 0.1), None)) is None
    several = {"target": ["coordinate:y", "coordinate:z"]}
    fixed = [(name, value) for name, value in PROBLEM.items() if name != "target"]
    rows = swept((0.02, 0.1), (0.03, 0.1))
    others = [
        SummaryRow(LedgerEntry(row, "done"), told.facts)
        for row, told in zip(combinations(fixed, several), rows, strict=True)
    ]
    assert best_of(others) is None
    film = Row("film", {"mesh": "a.off", "frames": "f.npy"})
    assert best_of([SummaryRow(LedgerEntry(film, "done"), facts("matched", 0.1, 0.1))] * 2) is None


def test_the_page_tells_it_and_frames_what_none_beats():
    over = {"alpha": ["0.01", "0.02"], "sigma-unit": ["relative", "absolute"]}
    rows = swept((0.02, 0.5), (0.03, 0.6), (0.04, 0.2), (0.05, 0.3), over=over)
    text = page("a sweep", rows, {}, "")
    assert "Closest: alpha 0.01, sigma-unit relative: 2% left, mean |log2 J| 0.50." in text
    assert "areas change least: alpha 0.02, sigma-unit relative: 4% left" in text
    assert text.count('<td><span class="framed">') == 2
    assert "0.500</td>" in text
    alone = page("a batch", rows[:1], {}, "")
    assert "<h2>Best</h2>" not in alone
    assert 'class="framed"' not in alone

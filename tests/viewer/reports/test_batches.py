"""The best rows of a batch that solves one problem with several settings."""

import math

import pytest

from abfm.batch import LedgerEntry, Row, combinations
from abfm.matching.judging.facts import known_numbers
from abfm.outcome import Facts, Outcome
from abfm_viewer.reports.batches import SummaryRow, batch_page, best_of
from tests.messages import check_message

PROBLEM = {"mesh": "a.off", "source": "coordinate:x", "target": "coordinate:y"}


def swept(*numbers, sigma="0.1", verdicts=None, over=None):
    """Return rows of a sweep over alpha with given residuals and mean |log2 J|."""
    alphas = [str(0.01 * 2**i) for i in range(len(numbers))]
    over = over or {"alpha": alphas}
    fixed = [(name, text) for name, text in PROBLEM.items() if name not in over]
    rows = combinations([*fixed, ("sigma", sigma)], over)
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


def test_best_rows_are_close_or_little_distorted():
    rows = swept((0.02, 0.5), (0.03, 0.4), (0.035, 0.45), (0.04, 0.2), (0.05, 0.2), None)
    best = best_of(rows)
    assert numbers(rows, best) == (0, 3, [0, 1, 3])
    closest, least = best.sentences()
    check_message(closest, "alpha 0.01", "2%", "0.50")
    check_message(least, "alpha 0.08", "4%", "0.20")
    (both,) = best_of(swept((0.02, 0.1), (0.03, 0.4))).sentences()
    check_message(both, "alpha 0.01", "2%", "0.10")
    unknown = best_of(swept((0.02, math.nan), (0.01, math.nan)))
    assert unknown.sentences() == ["closest match: alpha 0.02: residual 1%"]


def numbers(rows, best):
    """Return the numbers of the closest, the least distorted and the undominated rows."""
    of = {row.name: number for number, row in enumerate(rows)}
    names = best.to_dict()
    undominated = sorted(of[name] for name in best.undominated)
    return of[names["closest"]], of.get(names["areas_change_least"]), undominated


@pytest.mark.parametrize(
    ("rows", "wanted"),
    [  # rows that reached their target are preferred
        (
            swept((0.02, 0.1), (0.3, 0.05), (0.04, 0.2), verdicts=2 * ["not reached"] + ["nearly"]),
            (2, 2, [2]),
        ),
        (swept((0.4, 0.1), (0.3, 0.2), verdicts=2 * ["not reached"]), (1, 0, [0, 1])),
        (swept((0.02, 0.1), (0.02, 0.1), (0.02, math.nan)), (0, 0, [0, 1])),
        (swept((0.02, math.nan), (0.01, math.nan)), (1, None, [])),
    ],
)
def test_reached_rows_are_preferred_and_equal_ones_undominated(rows, wanted):
    assert numbers(rows, best_of(rows)) == wanted


@pytest.mark.parametrize("sigma", ["0.1", "auto"])
def test_residuals_below_noise_have_a_note(sigma):
    best = best_of(swept((0.2, 0.1), (0.3, 0.2), sigma=sigma, verdicts=["registered"] * 2))
    assert ("noise" in best.sentences()[-1]) == (sigma != "auto")


def test_different_problems_have_no_best_row():
    assert best_of([]) is None
    assert best_of(swept((0.02, 0.1), None)) is None
    assert best_of(swept((math.nan, 0.1), (0.1, 0.1))) is None
    over = {"source": ["coordinate:y", "coordinate:z"]}
    assert best_of(swept((0.02, 0.1), (0.03, 0.1), over=over)) is None
    sequence = LedgerEntry(Row("sequence", {"mesh": "a.off", "frames": "f.npy"}), "done")
    of_sequence = Facts(Outcome.MATCHED, "", numbers={"residual": 0.1, "motion_share": 0.5})
    assert best_of([SummaryRow(sequence, of_sequence)] * 2) is None


def test_page_frames_undominated_rows():
    over = {"alpha": ["0.01", "0.02"], "sigma-unit": ["relative", "absolute"]}
    rows = swept((0.02, 0.5), (0.03, 0.6), (0.04, 0.2), (0.05, 0.3), over=over)
    text = batch_page("a sweep", rows, {})
    best = "alpha 0.01, sigma-unit relative: residual 2%, mean |log2 J| 0.50."
    assert f"Closest match: {best}" in text
    assert ": alpha 0.02, sigma-unit relative: residual 4%" in text
    assert text.count('<td><span class="framed">') == 2
    assert "0.500</td>" in text
    alone = batch_page("a batch", rows[:1], {})
    assert "<h2>Best</h2>" not in alone
    assert 'class="framed"' not in alone

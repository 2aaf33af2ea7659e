"""Which of several ways to solve one problem is best."""

import math

import pytest

from abfm.batch import LedgerEntry, Row, combinations
from abfm.matching.judging.facts import known_numbers
from abfm.outcome import Facts, Outcome
from abfm_viewer.reports.batches import SummaryRow, batch_page, best_of
from tests.messages import check_message

PROBLEM = {"mesh": "a.off", "source": "coordinate:x", "target": "coordinate:y"}


def swept(*numbers, sigma="0.1", verdicts=None, over=None):
    """Rows of a sweep over alpha, with their residuals and mean |log2 J|."""
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


def test_best_rows():
    rows = swept((0.02, 0.5), (0.03, 0.4), (0.035, 0.45), (0.04, 0.2), (0.05, 0.2), None)
    best = best_of(rows)
    assert numbers(rows, best) == (0, 3, [0, 1, 3])
    closest, least = best.sentences()
    check_message(closest, "alpha 0.01", "2%", "0.50")
    check_message(least, "alpha 0.08", "4%", "0.20")
    (both,) = best_of(swept((0.02, 0.1), (0.03, 0.4))).sentences()
    check_message(both, "alpha 0.01", "2%", "0.10")
    unknown = best_of(swept((0.02, math.nan), (0.01, math.nan)))
    assert unknown.sentences() == ["closest: alpha 0.02: 1% left"]


def numbers(rows, best):
    """Numbers of the closest, of the one that changes areas least, and of those undominated."""
    of = {row.name: number for number, row in enumerate(rows)}
    told = best.to_dict()
    undominated = sorted(of[name] for name in best.undominated)
    return of[told["closest"]], of.get(told["areas_change_least"]), undominated


@pytest.mark.parametrize(
    ("rows", "wanted"),
    [  # those that did not reach their target count only among themselves
        (
            swept((0.02, 0.1), (0.3, 0.05), (0.04, 0.2), verdicts=2 * ["not reached"] + ["nearly"]),
            (2, 2, [2]),
        ),
        (swept((0.4, 0.1), (0.3, 0.2), verdicts=2 * ["not reached"]), (1, 0, [0, 1])),
        (swept((0.02, 0.1), (0.02, 0.1), (0.02, math.nan)), (0, 0, [0, 1])),
        (swept((0.02, math.nan), (0.01, math.nan)), (1, None, [])),
    ],
)
def test_failures_equals_and_unknowns(rows, wanted):
    assert numbers(rows, best_of(rows)) == wanted


@pytest.mark.parametrize("sigma", ["0.1", "auto"])
def test_closer_than_noise_is_no_better(sigma):
    told = best_of(swept((0.2, 0.1), (0.3, 0.2), sigma=sigma, verdicts=["registered"] * 2))
    assert ("noise" in told.sentences()[-1]) == (sigma != "auto")


def test_of_several_problems_none_is_best():
    assert best_of([]) is None
    assert best_of(swept((0.02, 0.1), None)) is None
    assert best_of(swept((math.nan, 0.1), (0.1, 0.1))) is None
    over = {"source": ["coordinate:y", "coordinate:z"]}
    assert best_of(swept((0.02, 0.1), (0.03, 0.1), over=over)) is None
    film = LedgerEntry(Row("film", {"mesh": "a.off", "frames": "f.npy"}), "done")
    of_film = Facts(Outcome.MATCHED, "", numbers={"residual": 0.1, "motion_share": 0.5})
    assert best_of([SummaryRow(film, of_film)] * 2) is None


def test_page_frames_undominated_rows():
    over = {"alpha": ["0.01", "0.02"], "sigma-unit": ["relative", "absolute"]}
    rows = swept((0.02, 0.5), (0.03, 0.6), (0.04, 0.2), (0.05, 0.3), over=over)
    text = batch_page("a sweep", rows, {})
    assert "Closest: alpha 0.01, sigma-unit relative: 2% left, mean |log2 J| 0.50." in text
    assert "areas change least: alpha 0.02, sigma-unit relative: 4% left" in text
    assert text.count('<td><span class="framed">') == 2
    assert "0.500</td>" in text
    alone = batch_page("a batch", rows[:1], {})
    assert "<h2>Best</h2>" not in alone
    assert 'class="framed"' not in alone

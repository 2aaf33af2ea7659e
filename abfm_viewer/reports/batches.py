"""Reports of a batch: its rows, the best rows, and a page of the worst rows."""

import heapq
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from abfm.batch import KINDS, LedgerEntry
from abfm.outcome import Facts, Outcome
from abfm.parameters import FIELDS, option
from abfm.wording import share
from abfm_viewer.reports.pages import abbreviated, render

ROWS_SHOWN_MAX = 1000  # rows on a page; with their pictures it has about 6 MB
_NUMBERS = ("residual", "verified_residual", "folded", "log2_area")
_HEADS = ("", "residual", "along flow lines", "folded", "|log2\u00a0J|", "seconds")
_SETTINGS = {*map(option, FIELDS), "start", "initial", "max-distortion"}
"""Names of options that change how a problem is solved, but not the problem itself."""


class SummaryRow(NamedTuple):
    """A row of a batch and its facts, which contain numbers only if the row has a result."""

    entry: LedgerEntry
    facts: Facts

    @property
    def name(self) -> str:
        return self.entry.row.name

    @property
    def is_known(self) -> bool:
        return bool(self.facts.numbers)

    @property
    def residual(self) -> float:
        """The larger of the discrete and the flow-line residual; infinite if it is unknown."""
        return _or_infinite(self.facts.worse_residual)

    @property
    def areas(self) -> float:
        """The mean |log2 J| of the row's map; infinite if it is unknown."""
        return _or_infinite(self.facts.number("log2_area"))

    def to_dict(self) -> dict[str, Any]:
        entry, facts = self.entry, self.facts
        return {
            "name": self.name,
            "digest": entry.digest or None,
            "verdict": str(facts.outcome),
            **{number: facts.numbers.get(number) for number in _NUMBERS},
            "seconds": entry.record.seconds,
            "reason": facts.reason or None,
            "file": None if entry.path is None else entry.path.name,
        }


def counts(rows: Iterable[SummaryRow]) -> dict[Outcome, int]:
    found = Counter(row.facts.outcome for row in rows)
    return {outcome: found[outcome] for outcome in sorted(found, key=lambda each: each.rank)}


def worst(rows: Sequence[SummaryRow]) -> list[SummaryRow]:
    """Return at most `ROWS_SHOWN_MAX` rows, sorted by worst outcome, then by largest residual."""
    return heapq.nsmallest(ROWS_SHOWN_MAX, rows, key=_goodness)


def _goodness(row: SummaryRow) -> tuple[int, float]:
    residual = row.facts.worse_residual
    return -row.facts.outcome.rank, -residual if residual > 0 else 0.0


class Best(NamedTuple):
    """The best rows of a batch that solves one problem with several settings.

    If some rows reached their target, only these are compared.
    """

    closest: SummaryRow  # the row with the smallest residual
    least_distorted: SummaryRow | None  # the row whose map changes areas least, if known
    reached: bool  # whether the compared rows reached their target
    # names of rows for which no other row is better in both residual and area change
    undominated: frozenset[str]

    def to_dict(self) -> dict[str, str | None]:
        other = None if self.least_distorted is None else self.least_distorted.name
        return {"closest": self.closest.name, "areas_change_least": other}

    def sentences(self) -> list[str]:
        first, other = self.closest, self.least_distorted
        if other is None or other is first:
            both = "" if other is None else " and least change of areas"
            found = [f"closest match{both}: {_cost_text(first)}"]
        else:
            which = " among the rows that reached their target" if self.reached else ""
            found = [
                f"closest match: {_cost_text(first)}",
                f"least change of areas{which}: {_cost_text(other)}",
            ]
        has_sigma = dict(first.entry.row.options).get("sigma", "auto") != "auto"
        if first.facts.outcome is Outcome.REGISTERED and has_sigma:
            found.append(
                "the functions were measured, and a residual below their noise is not better; "
                "sigma auto stops where held-out data no longer improve"
            )
        return found


def best_of(rows: Sequence[SummaryRow]) -> Best | None:
    """Return the best rows of a batch that solves one problem with several settings.

    The result is None for several problems, fewer than two results, or unknown area changes.
    """
    if not rows or any(_problem(row) != _problem(rows[0]) for row in rows):
        return None
    known = [row for row in rows if row.residual < math.inf]
    if len(known) < 2 or not any("log2_area" in row.facts.numbers for row in known):
        return None
    good = [row for row in known if row.facts.outcome.is_good]
    compared = good or known
    closest = min(compared, key=lambda row: (row.residual, row.areas))
    with_areas = [row for row in compared if row.areas < math.inf]
    least_distorted = min(with_areas, key=lambda row: (row.areas, row.residual), default=None)
    return Best(closest, least_distorted, bool(good), _undominated(with_areas))


def _problem(row: SummaryRow) -> list[tuple[str, str]]:
    return [pair for pair in row.entry.row.options if pair[0] not in _SETTINGS]


def _or_infinite(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _undominated(rows: Sequence[SummaryRow]) -> frozenset[str]:
    found, least, last = set[str](), math.inf, (math.nan, math.nan)
    for row in sorted(rows, key=lambda row: (row.residual, row.areas)):
        pair = row.residual, row.areas
        if pair[1] < least or pair == last:
            found.add(row.name)
            least, last = pair[1], pair
    return frozenset(found)


def _cost_text(row: SummaryRow) -> str:
    cost = f", mean |log2 J| {row.areas:.2f}" if row.areas < math.inf else ""
    return f"{row.name}: residual {share(row.residual)}{cost}"


class Grid(NamedTuple):
    across: list[str]
    down: list[tuple[str, list[SummaryRow]]]


def batch_page(
    title: str, rows: Sequence[SummaryRow], pictures: Mapping[str, bytes], no_pictures: str = ""
) -> str:
    """Return the page of a batch, worst rows first, at most `ROWS_SHOWN_MAX` of them.

    ``pictures`` are PNG by digest of the row, ``no_pictures`` is the reason for missing pictures.
    """
    shown = worst(rows)
    kinds = Counter(row.entry.row.kind for row in rows)
    labels = {kind: ", ".join(KINDS[kind].preview_labels) for kind in kinds}
    heads = sorted({labels[row.entry.row.kind] for row in shown}, reverse=True)
    return render(
        "batch.html",
        batch=title,
        sizes=[
            f"{count:,} {kind}{('es' if kind.endswith('ch') else 's') * (count > 1)}"
            for kind, count in kinds.items()
        ],
        counts=counts(rows),
        no_pictures=no_pictures,
        shared=_shared(rows),
        best=best_of(rows),
        grid=_grid(rows) if len(shown) == len(rows) else None,
        heads=("; ".join(heads), *_HEADS),
        labels=labels,
        rows=shown,
        count=len(rows),
        pictures=pictures,
        facts={"title": title, "count": len(rows), "rows": list(map(_facts, shown))},
    )


def _facts(row: SummaryRow) -> dict[str, object]:
    found = row.to_dict()
    return {
        key: abbreviated(value) if isinstance(value, str) else value for key, value in found.items()
    }


def _shared(rows: Sequence[SummaryRow]) -> list[tuple[str, str]]:
    if len(rows) < 2:
        return []
    found = dict.fromkeys(rows[0].entry.row.options)
    for row in rows:
        found = {pair: None for pair in found if pair in row.entry.row.options}
        if not found:
            break
    return list(found)


def _grid(rows: Sequence[SummaryRow]) -> Grid | None:
    """Return rows as a grid if they are all combinations of two options' values, else None."""
    every = [dict(row.entry.row.options) for row in rows]
    varied = [name for name in every[0] if len({each.get(name) for each in every}) > 1]
    if len(varied) != 2:
        return None
    down, across = varied
    found = {(o.get(down, ""), o.get(across, "")): row for o, row in zip(every, rows, strict=True)}
    downs, acrosses = (sorted({pair[i] for pair in found}, key=_by_size) for i in range(2))
    if len(found) < len(rows) or len(found) < len(downs) * len(acrosses):
        return None
    return Grid(
        [f"{across} {text}" for text in acrosses],
        [(f"{down} {one}", [found[one, other] for other in acrosses]) for one in downs],
    )


def _by_size(text: str) -> tuple[float, str]:
    try:
        return float(text), ""
    except ValueError:
        return float("inf"), text

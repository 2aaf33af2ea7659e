"""How often matches succeeded, by distance, width and family, all versions side by side."""

import math
from collections.abc import Iterator
from statistics import median
from typing import Any

from laboratory.machine import in_words
from laboratory.success.problems import DISTANCES, FAMILIES, WIDTHS
from laboratory.success.record import CONFIRMED, UNFOLDED
from laboratory.tables import aligned, markdown
from laboratory.watched import LEVEL

Row = dict[str, Any]

_ARROW = " → "


def format_success(report: dict[str, Any]) -> str:
    """Return the report of `run_success` as aligned lines of text."""
    return "\n".join([*aligned(_table(report)), "", *_context(report)])


def success_table(report: dict[str, Any]) -> str:
    """Return the report of `run_success` as a table in Markdown."""
    return "\n".join([*markdown(_table(report)), "", "\n\n".join(_context(report))])


def _table(report: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a header, and a row for every group of problems."""
    versions = list(report["settings"]["versions"])
    header = (
        "problems",
        "succeeded",
        "confirmed",
        "mismatch",
        "by flow lines",
        "unfolded",
        "products",
        "seconds",
    )
    return [header, *(_cells(name, group, versions) for name, group in _groups(report["rows"]))]


def _groups(rows: list[Row]) -> Iterator[tuple[str, list[Row]]]:
    """Return names of groups, and what is in them; those without problems are left out."""
    yield "all", rows
    groups: dict[str, dict[str, Any]] = {
        "resolved": {"resolved": True},
        **{f"distance {distance}": {"distance": distance} for distance in DISTANCES},
        **{f"width {width:g}": {"width": width} for width in WIDTHS},
        **{family: {"family": family} for family in FAMILIES},
        "solvable": {"solvable": True},
        "solvable, resolved": {"solvable": True, "resolved": True},
        **{
            f"solvable, {distance}": {"solvable": True, "distance": distance}
            for distance in DISTANCES
        },
    }
    for name, wanted in groups.items():
        group = [
            row
            for row in rows
            if all(row["problem"][key] == value for key, value in wanted.items())
        ]
        if group:
            yield name, group


def _cells(name: str, group: list[Row], versions: list[str]) -> tuple[str, ...]:
    resolved = [row for row in group if row["problem"]["resolved"]]
    records = [[row[version] for row in group] for version in versions]

    def count(among: list[Row], key: str) -> str:
        counts = [str(sum(row[version][key] for row in among)) for version in versions]
        return f"{_ARROW.join(counts)} of {len(among)}"

    return (
        name,
        count(group, "success"),
        count(resolved, "confirmed"),
        *(_ARROW.join(_median(each, key) for each in records) for key in ("mismatch", "verified")),
        _ARROW.join(_unfolded(each) for each in records),
        *(_ratio(group, versions, cost) for cost in ("row_products", "seconds")),
    )


def _median(records: list[Row], key: str) -> str:
    """Return the median, where what could not be had counts as infinite."""
    value = (
        median(math.inf if record[key] is None else record[key] for record in records)
        if records
        else math.inf
    )
    return f"{value:.2g}" if math.isfinite(value) else "none"


def _unfolded(records: list[Row]) -> str:
    count = sum(record["folded"] is not None and record["folded"] <= UNFOLDED for record in records)
    return f"{100 * count / len(records):.0f}%" if records else "none"


def _ratio(group: list[Row], versions: list[str], cost: str) -> str:
    """Return median of what the first version costs over what the last does, where both succeed."""
    first, last = versions[0], versions[-1]
    both = [
        row for row in group if row[first]["success"] and row[last]["success"] and row[last][cost]
    ]
    return (
        f"{median(row[first][cost] / row[last][cost] for row in both):.2g}"
        if both and first != last
        else "none"
    )


def _context(report: dict[str, Any]) -> list[str]:
    """Say what the columns mean, and where this was measured."""
    settings = report["settings"]
    versions = list(settings["versions"])
    sums = [
        f"{sum(row[version]['seconds'] for row in report['rows']):.0f} s" for version in versions
    ]
    first, last = versions[0], versions[-1]
    return [
        f"{_ARROW.join(versions)}. Succeeded: mismatch at most {LEVEL:g}. Confirmed: at most "
        f"{CONFIRMED:g} by flow "
        "lines, of resolved problems. Solvable: the source has the target's values and peaks. "
        "Mismatches are medians. "
        f"Unfolded: share of matches that fold at most {100 * UNFOLDED:g}% of the faces. "
        "Products, seconds: what "
        f"{first} costs over what {last} costs, median over problems in which both succeed.",
        f"{len(report['rows'])} problems on {len(settings['meshes'])} meshes, seed "
        f"{settings['seed']}; "
        f"{_ARROW.join(sums)} in all. {in_words(report['machine'])}.",
    ]

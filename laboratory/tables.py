"""Tables of measurements, for readers."""

from collections.abc import Sequence

Row = Sequence[str]


def markdown(rows: Sequence[Row]) -> list[str]:
    """Return lines of a table in Markdown, of which the first row is the header."""
    header, *others = rows
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *others)]


def aligned(rows: Sequence[Row]) -> list[str]:
    """Return lines of text with the cells of a column below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def number(value: float | None) -> str:
    """Return three digits, or that there is none."""
    return "not reached" if value is None else f"{value:.3g}"

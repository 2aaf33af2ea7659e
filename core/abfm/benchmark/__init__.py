"""The solver against the baselines, measured: `run` gives a report, `format_report` and `markdown_table` show it."""

from abfm.benchmark.cosines import cosine_table, cosines
from abfm.benchmark.measure import run
from abfm.benchmark.report import format_report, markdown_table

__all__ = ["cosine_table", "cosines", "format_report", "markdown_table", "run"]

"""The solver against the baselines, measured: `run` gives a report, `format_report` and `markdown_table` show it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Batches of problems: tables, a ledger of finished rows, and workers that solve the rows."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Measurements of the solver and of the window, run from the repository: `abfm bench`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

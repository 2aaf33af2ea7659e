"""Readers of files of values and labels, which check sizes before they allocate memory."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

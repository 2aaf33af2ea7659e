"""Surfaces in one file for a browser, turning, with a time bar, without server or network."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The figures of the paper as scripts that run again, with numbers and a sheet to draw."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Functions on a mesh: their text form, their families, and readers of values at vertices."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

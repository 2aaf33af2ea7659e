"""Writers of result files and exports; a crash never leaves an incomplete file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

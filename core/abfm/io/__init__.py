"""Files that come out: results that reload, and exports; a crash leaves no half a file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

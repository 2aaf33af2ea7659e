"""Interactive pages: rotating surfaces with a time bar, in one HTML file without a server."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

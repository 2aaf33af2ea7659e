"""Two surfaces: where points of one lie on the other, and how that is found."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

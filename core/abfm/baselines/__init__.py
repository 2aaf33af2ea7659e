"""Methods for comparison: linear blend, optimal transport, optical flow and a reduced basis."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

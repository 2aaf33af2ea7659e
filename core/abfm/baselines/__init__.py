"""What a user would compare with: the linear blend, optimal transport, a reduced basis."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Functions on a mesh: families given as text, evaluated to one finite value per vertex."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

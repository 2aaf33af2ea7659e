"""Initial maps between two surfaces: each way returns where on A every vertex of B lies."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

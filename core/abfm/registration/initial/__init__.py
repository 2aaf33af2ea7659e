"""Initial maps between two surfaces: each method maps the vertices of B to points of A."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

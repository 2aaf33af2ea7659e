"""Discrete calculus on a mesh: operators, fields, decompositions, eigenfunctions, distances."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Advection-based function matching on surfaces: find the tangent field whose flow carries one function to another.

Names are imported when they are first used, here and in the rooms, so that a program that only reads meshes starts
without the solver. ``__init__.pyi`` beside each ``__init__.py`` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

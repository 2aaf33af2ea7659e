"""Declarations of tasks: their inputs, how they are solved, and what their results provide."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

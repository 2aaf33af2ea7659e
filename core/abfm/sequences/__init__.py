"""Functions that change in time, and the fields whose flows map each frame to the next."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

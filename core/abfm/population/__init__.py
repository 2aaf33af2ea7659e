"""Populations: many subjects, their mean on a template, how they vary, and who does not fit."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

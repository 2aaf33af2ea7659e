"""Automation of the app by the labels of its widgets, with or without a screen."""

from abfm_viewer.errors import attach_app_stub

__getattr__, __dir__, __all__ = attach_app_stub(__name__, __file__)

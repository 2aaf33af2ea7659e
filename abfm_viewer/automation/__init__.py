"""Automation of the app by the labels of its widgets, with or without a screen."""

from abfm_viewer.errors import app_room

__getattr__, __dir__, __all__ = app_room(__name__, __file__)

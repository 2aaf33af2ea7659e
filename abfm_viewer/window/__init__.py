"""The window: frame loop, menus, keyboard, mouse and recovery of unsaved work."""

from abfm_viewer.errors import app_room

__getattr__, __dir__, __all__ = app_room(__name__, __file__)

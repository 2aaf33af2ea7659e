"""The window: frame loop, menus, keyboard, mouse and recovery of unsaved work."""

from abfm_viewer.errors import attach_app_stub

__getattr__, __dir__, __all__ = attach_app_stub(__name__, __file__)

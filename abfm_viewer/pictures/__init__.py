"""Off-screen pictures of documents, sheets, figures and results, and movies."""

from abfm_viewer.errors import app_room

__getattr__, __dir__, __all__ = app_room(__name__, __file__)

"""Off-screen pictures of documents, sheets, figures and results, and movies."""

from abfm_viewer.errors import attach_app_stub

__getattr__, __dir__, __all__ = attach_app_stub(__name__, __file__)

"""Pictures off the screen: of documents, sheets, movies, figures."""

from typing import Any

import lazy_loader

from abfm_viewer.errors import app_installed

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    with app_installed():
        return _load(name)

"""Warnings of the library, shown as cards in the window."""

import warnings
from collections import deque
from typing import Any

from abfm.errors import AbfmWarning
from abfm_viewer.session.notices import Notices


class LibraryWarnings:
    """Collects warnings of the library from all threads; other warnings are printed as usual."""

    def __init__(self) -> None:
        self._texts: deque[str] = deque()
        self._before = warnings.showwarning
        warnings.showwarning = self._collect

    def update(self, notices: Notices) -> None:
        """Show the collected warnings as cards. Call once per frame."""
        while self._texts:
            notices.show(self._texts.popleft(), True)

    def close(self) -> None:
        warnings.showwarning = self._before

    def _collect(
        self, message: Warning | str, category: type[Warning], *place: Any, **more: Any
    ) -> None:
        if issubclass(category, AbfmWarning):
            self._texts.append(str(message))
        else:
            self._before(message, category, *place, **more)

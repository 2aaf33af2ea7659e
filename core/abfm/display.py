"""Objects that are shown in notebooks and in a browser."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any


def _notebook() -> Any:
    # pages are above all that they show, so that they are found when they are first used
    return import_module("abfm.pages.notebook")


class Display:
    """A surface, or a result on surfaces, that `abfm.pages` can show."""

    def _repr_html_(self) -> str:
        """Return a live view for a notebook, with the verdict."""
        return str(_notebook().embedded(self))

    def show(self, path: str | os.PathLike[str] | None = None, up: str | None = None) -> Path:
        """Write a page that shows the surfaces and open it in a browser.

        Parameters
        ----------
        path : path, optional
            The page, ``.html``; by default a new file in the folder for temporary files.
        up : {"x", "y", "z"}, optional
            The axis that points upwards; by default z for a cortex of known hemisphere, else y.

        Returns
        -------
        Path
            The page. Without a browser its path is also printed.

        Raises
        ------
        AbfmError
            If the page cannot be made or written.
        """
        return Path(_notebook().show(self, path, up))

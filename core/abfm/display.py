"""Display of surfaces and results in notebooks and browsers."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any


def _notebook() -> Any:
    # imported late, because abfm.pages imports the classes that it displays
    return import_module("abfm.pages.notebook")


class Display:
    """Base class of surfaces and results that `abfm.pages` can show."""

    def _repr_html_(self) -> str:
        """Return the HTML of an interactive view with the verdict, for a notebook."""
        return str(_notebook().embedded(self))

    def show(self, path: str | os.PathLike[str] | None = None, up: str | None = None) -> Path:
        """Write a page that shows the surfaces and open it in a browser.

        Parameters
        ----------
        path : path, optional
            The HTML file to write; by default a new temporary file.
        up : {"x", "y", "z"}, optional
            The axis that points upwards. The default is z for a cortex of known hemisphere, else y.

        Returns
        -------
        Path
            The HTML file. If no browser is available, its path is also printed.

        Raises
        ------
        AbfmError
            If the page cannot be made or written.
        """
        return Path(_notebook().show(self, path, up))

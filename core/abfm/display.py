"""Display of surfaces and results in notebooks and browsers, and names of views."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, get_args

from abfm.errors import ParameterError, brief

ViewName = Literal["best", "front", "back", "left", "right", "top", "bottom"]
UpAxis = Literal["auto", "x", "y", "z"]
VIEWS: tuple[ViewName, ...] = get_args(ViewName)
UP_AXES: tuple[UpAxis, ...] = get_args(UpAxis)


@dataclass(frozen=True)
class ViewSpec:
    """The side from which surfaces are shown, and the axis upwards; see ``abfm.pages.front``."""

    name: ViewName = "best"
    up: UpAxis = "auto"

    def __post_init__(self) -> None:
        for name, value, known in (("view", self.name, VIEWS), ("up", self.up, UP_AXES)):
            if value not in known:
                raise ParameterError(f"{name} is {brief(value)}; expected {', '.join(known)}")


BEST_VIEW = ViewSpec()


def _notebook() -> Any:
    # imported late, because abfm.pages imports the classes that it displays
    return import_module("abfm.pages.notebook")


class Display:
    """Base class of surfaces and results that `abfm.pages` can show."""

    def _repr_html_(self) -> str:
        """Return the HTML of an interactive view with the verdict, for a notebook."""
        return str(_notebook().embedded(self))

    def show(
        self,
        path: str | os.PathLike[str] | None = None,
        up: UpAxis = "auto",
        view: ViewName = "best",
    ) -> Path:
        """Write a page that shows the surfaces and open it in a browser.

        Parameters
        ----------
        path : path, optional
            The HTML file to write; by default a new temporary file.
        up : {"auto", "x", "y", "z"}
            The axis that points upwards, by default that of `abfm.pages.front`.
        view : {"best", "front", "back", "left", "right", "top", "bottom"}
            The side from which the surfaces are shown.

        Returns
        -------
        Path
            The HTML file. If no browser is available, its path is also printed.

        Raises
        ------
        AbfmError
            If the page cannot be made or written.
        """
        return Path(_notebook().show(self, path, ViewSpec(view, up)))

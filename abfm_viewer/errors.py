"""Errors of the viewer other than bad input."""

from collections.abc import Callable
from typing import Any

import lazy_loader

from abfm.errors import AbfmError

_APP_PACKAGES = {"av": "PyAV", "matplotlib": "Matplotlib", "PIL": "Pillow"}
_APP_PACKAGES |= {name: name for name in ("platformdirs", "polyscope")}


class DrawingError(AbfmError):
    """The machine cannot draw: a library, a driver or a screen is missing."""


class DriverError(AbfmError):
    """A request to the `Driver` that no user could make, such as a click on a disabled button."""


def attach_app_stub(
    name: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package, which imports names late.

    If a library that only the app needs is missing, a `DrawingError` names it and explains how to
    install it.
    """
    load, names, every = lazy_loader.attach_stub(name, file)

    def get(attribute: str) -> Any:
        try:
            return load(attribute)
        except ModuleNotFoundError as error:
            missing = _APP_PACKAGES.get((error.name or "").partition(".")[0])
            if missing is None:
                raise
            raise DrawingError(
                f"the window and its pictures need {missing}; install it: pip install 'abfm[app]'"
            ) from None

    return get, names, every

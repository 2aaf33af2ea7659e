"""What can go wrong in the viewer besides bad input."""

from collections.abc import Callable
from typing import Any

import lazy_loader

from abfm.errors import AbfmError

_OF_THE_APP = {"av": "PyAV", "matplotlib": "Matplotlib", "PIL": "Pillow"}
_OF_THE_APP |= {name: name for name in ("platformdirs", "polyscope")}


class DrawingError(AbfmError):
    """The machine cannot draw: a library, a driver or a screen is missing."""


class DriverError(AbfmError):
    """Something that a user could not have done: no such label, a grey button, a vertex that
    cannot be seen.
    """


def app_room(
    name: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return a room's `__getattr__`, `__dir__` and `__all__`: the names of its stub are loaded when
    they are first used.

    Where a package that only the app needs is missing, that is a `DrawingError`, which says in one
    line what to install.
    """
    load, names, every = lazy_loader.attach_stub(name, file)

    def get(attribute: str) -> Any:
        try:
            return load(attribute)
        except ModuleNotFoundError as error:
            missing = _OF_THE_APP.get((error.name or "").partition(".")[0])
            if missing is None:
                raise
            raise DrawingError(
                f"the window and its pictures need {missing}; type: pip install 'abfm[app]'"
            ) from None

    return get, names, every

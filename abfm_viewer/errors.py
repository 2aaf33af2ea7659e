"""What can go wrong in the viewer besides bad input."""

from collections.abc import Iterator
from contextlib import contextmanager

from abfm.errors import AbfmError

_OF_THE_APP = {
    "av": "PyAV",
    "matplotlib": "Matplotlib",
    "PIL": "Pillow",
    "platformdirs": "platformdirs",
    "polyscope": "polyscope",
}


class DrawingError(AbfmError):
    """The machine cannot draw: a library, a driver or a screen is missing."""


class DriverError(AbfmError):
    """Something that a user could not have done: no such label, a grey button, a vertex that
    cannot be seen.
    """


@contextmanager
def app_installed() -> Iterator[None]:
    """Tell in one line what to install where a package that only the app needs is missing.

    Raises
    ------
    DrawingError
        In place of a `ModuleNotFoundError` for one of them.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = _OF_THE_APP.get((error.name or "").partition(".")[0])
        if missing is None:
            raise
        raise DrawingError(
            f"the window and its pictures need {missing}; type: pip install 'abfm[app]'"
        ) from None

"""What can go wrong in the viewer besides bad input."""

from abfm.errors import AbfmError


class DrawingError(AbfmError):
    """The machine cannot draw: a library, a driver or a screen is missing."""

"""What can go wrong in the viewer besides bad input."""

from abfm.errors import AbfmError


class DrawingError(AbfmError):
    """The machine cannot draw: a library, a driver or a screen is missing."""


class DriverError(AbfmError):
    """Something that a user could not have done: no such label, a grey button, a vertex that cannot be seen."""

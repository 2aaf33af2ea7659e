"""Errors that a user can cause and mend: each says what was given, what was expected and what to do."""


class AbfmError(ValueError):
    """Base of every error raised for bad input; the command line prints it as one line and exits with 2."""


class MeshError(AbfmError):
    """A mesh that the solver cannot use."""


class FunctionError(AbfmError):
    """A function specification or array that does not give one finite value per vertex."""


class ParameterError(AbfmError):
    """A parameter outside its range."""


class ResultError(AbfmError):
    """A result file that cannot be read or written."""


class AdvectionError(AbfmError):
    """A field so fast, or a time so long, that the advection cannot be computed in reasonable time or range."""

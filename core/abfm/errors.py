"""Errors that a user can cause and mend: each says what was given, what was expected and what to do."""

from collections.abc import Iterable
from difflib import get_close_matches

_LONGEST = 600  # characters of a message


class AbfmError(ValueError):
    """Base of every error raised for bad input; the command line prints it as one line and exits with 2.

    Its text is one line that can be printed, not too long, whatever names and values are in it.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


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


def one_line(text: str, longest: int = _LONGEST) -> str:
    """A text for a person on one line: what cannot be printed is escaped, and a long one lacks its middle."""
    line = " ".join(part for part in map(str.strip, text.splitlines()) if part)
    if not line.isprintable():
        line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in line)
    half = (longest - 5) // 2
    return line if len(line) <= longest else f"{line[:half]} ... {line[-half:]}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """``" (did you mean ...?)"``, or nothing where no known word is near."""
    close = get_close_matches(word.strip().lower(), list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""

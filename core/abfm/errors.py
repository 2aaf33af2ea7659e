"""Errors that a user can cause and mend: what was given, expected, and what to do."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from itertools import islice
from typing import Any, NamedTuple

# words, and letters of each, as comparing takes long
_WORDS_MAX = 1000
_LETTERS_MAX = 60

MESSAGE_LENGTH_MAX = 600  # characters of a message


class AbfmError(ValueError):
    """Base of every error raised for bad input; the command line prints it as one line and exits
    with 2.

    Its text is one line that can be printed, not too long, whatever names and values are in it.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message), MESSAGE_LENGTH_MAX) if message else "")


class AbfmWarning(UserWarning):
    """Input that is used, but may be wrong; the command line prints it as one line."""


class Remedy(NamedTuple):
    """Options of `abfm.load_mesh` that make a mesh usable, and what of it they keep."""

    options: Mapping[str, Any]
    button: str
    keeps: str


class MeshError(AbfmError):
    """A mesh that the solver cannot use.

    Attributes
    ----------
    problem : str
        What is wrong, without advice; empty if no option helps.
    remedies : tuple of Remedy
        Options with which the mesh can be used; each was tried.
    """

    problem: str = ""
    remedies: tuple[Remedy, ...] = ()

    def of(self, whose: str) -> "MeshError":
        """Return the same error, of a file that is named."""
        found = MeshError(f"{whose}: {self}")
        found.problem, found.remedies = self.problem, self.remedies
        return found


class FunctionError(AbfmError):
    """A function specification or array that does not give one finite value per vertex."""


class SeveralArraysError(FunctionError):
    """A file with several arrays, none of which was chosen; `names` are theirs."""

    def __init__(self, message: object, names: Iterable[str]) -> None:
        super().__init__(message)
        self.names = tuple(names)

    def of(self, whose: str) -> "SeveralArraysError":
        """Return the same, said of a file that is named."""
        return SeveralArraysError(f"{whose}: {one_line(self, 400)}", self.names)


class ParameterError(AbfmError):
    """A parameter outside its range."""


class ResultError(AbfmError):
    """A result file that cannot be read or written."""


class AdvectionError(AbfmError):
    """A field so fast, or a time so long, that the advection cannot be computed in reasonable
    time or range.
    """


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean ...?)"``, or nothing where no known word is near."""
    near = [name for name in islice(known, _WORDS_MAX) if len(name) <= _LETTERS_MAX]
    close = get_close_matches(word.strip().lower(), near, n=1) if len(word) <= _LETTERS_MAX else []
    return f" (did you mean {close[0]!r}?)" if close else ""


def one_line(what: object, most: int = 200) -> str:
    """Return the text of an error, a path or anything else on one line of at most so many
    characters, the middle left out.

    What cannot be printed becomes a question mark. An error of the operating system is what it says
    without its path; an error that says nothing is named by its type.
    """
    text = (what.strerror if isinstance(what, OSError) else None) or str(what)
    if isinstance(what, UnicodeDecodeError):
        text = f"byte {what.start}, counting from 0, is no text in {what.encoding.upper()}"
    elif isinstance(what, UnicodeEncodeError):
        text = f"character {what.start}, counting from 0, is none that a text may have"
    if isinstance(what, BaseException) and not text.strip():
        text = type(what).__name__
    if len(text) > 2 * most:  # of a text of any length, no more is looked at
        text = f"{text[:most]} ... {text[-most:]}"
    text = printable(" ".join(text.split()))
    end = most // 4
    return text if len(text) <= most else f"{text[: most - end - 3]}...{text[-end:]}"


def printable(text: object) -> str:
    """Return a text with question marks for what cannot be printed: line ends, colours."""
    return "".join(sign if sign.isprintable() else "?" for sign in str(text))


def brief(value: object) -> str:
    """Return a value that was given, as an error shows it: on one line of at most 60 characters."""
    try:
        return one_line(repr(value), 60)
    except ValueError:  # Python's own limit
        return "a number of very many digits"

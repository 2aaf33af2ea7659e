"""Errors and warnings about input, and helpers to format their messages."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from itertools import islice
from typing import Any, NamedTuple

# limits of the search for similar words, which is slow
_WORDS_MAX = 1000  # words of a message
_LETTERS_MAX = 60  # letters of a word

MESSAGE_LENGTH_MAX = 600  # characters of a message


class AbfmError(ValueError):
    """Base class of the errors that report invalid input.

    The message is one printable line of limited length, whatever names and values it contains. The
    command line prints it and exits with status 2.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message), MESSAGE_LENGTH_MAX) if message else "")


class AbfmWarning(UserWarning):
    """Warning about input that is used although it may be wrong; the command line prints it."""


class Remedy(NamedTuple):
    """Options of `abfm.load_mesh` that make a mesh usable, and the properties that these keep."""

    options: Mapping[str, Any]
    button: str
    keeps: str


class MeshError(AbfmError):
    """A mesh that the solver cannot use.

    Attributes
    ----------
    problem : str
        The fault, without advice; empty if no option of `abfm.load_mesh` helps.
    remedies : tuple of Remedy
        Options with which the mesh can be used. Each was tried on this mesh.
    """

    problem: str = ""
    remedies: tuple[Remedy, ...] = ()

    def in_file(self, name: str) -> "MeshError":
        """Return this error with the name of a file at the beginning of its message."""
        found = MeshError(f"{name}: {self}")
        found.problem, found.remedies = self.problem, self.remedies
        return found


class FunctionError(AbfmError):
    """A function specification or an array that does not provide one finite value per vertex."""


class SeveralArraysError(FunctionError):
    """A file with several arrays, where the caller has to choose one of `names`."""

    def __init__(self, message: object, names: Iterable[str]) -> None:
        super().__init__(message)
        self.names = tuple(names)

    def in_file(self, name: str) -> "SeveralArraysError":
        return SeveralArraysError(f"{name}: {one_line(self, 400)}", self.names)


class ParameterError(AbfmError):
    """A parameter outside its range."""


class ColumnError(ParameterError):
    """A missing or wrong value in a ``column`` of a table, or in the option of the same name."""

    def __init__(self, column: str, text: str) -> None:
        super().__init__(f"column {column}{text}")
        self.column, self._text = column, text

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.column, self._text)

    def message_with(self, name: str) -> str:
        """Return the message with the name of an option in place of the name of the column."""
        return one_line(f"{name}{self._text}", MESSAGE_LENGTH_MAX)


class StartError(ParameterError):
    """An initial field that a match cannot start from, for example because it is too fast."""


class ResultError(AbfmError):
    """A result file that cannot be read or written."""


class AdvectionError(AbfmError):
    """A field so fast, or a time so long, that the flow cannot be computed.

    The computation would take too long, or its values would overflow.
    """


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return " (did you mean ...?)" with the closest known word; empty if none is similar."""
    if len(word) > _LETTERS_MAX:
        return ""
    candidates = [name for name in islice(known, _WORDS_MAX) if len(name) <= _LETTERS_MAX]
    close = get_close_matches(word.strip().lower(), candidates, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def one_line(value: object, length_max: int = 200) -> str:
    """Return a value as printable text on one line, with its middle omitted if it is too long.

    The text has at most ``length_max`` characters. Those that cannot be printed become question
    marks. For an error of the operating system, it is the message without the path. For an error
    without a message, it is the name of the type.
    """
    text = (value.strerror if isinstance(value, OSError) else None) or str(value)
    if isinstance(value, UnicodeDecodeError):
        text = f"byte {value.start}, counting from 0, is not valid {value.encoding.upper()}"
    elif isinstance(value, UnicodeEncodeError):
        text = f"character {value.start}, counting from 0, cannot be written as text"
    if isinstance(value, BaseException) and not text.strip():
        text = type(value).__name__
    if len(text) > 2 * length_max:  # bounds the work for very long texts
        text = f"{text[:length_max]} ... {text[-length_max:]}"
    text = printable(" ".join(text.split()))
    end = length_max // 4
    return text if len(text) <= length_max else f"{text[: length_max - end - 3]}...{text[-end:]}"


def printable(text: object) -> str:
    """Return a text with question marks for unprintable characters, such as line ends."""
    return "".join(character if character.isprintable() else "?" for character in str(text))


def brief(value: object) -> str:
    """Return the repr of a value for a message: one line of at most 60 characters."""
    try:
        return one_line(repr(value), 60)
    except ValueError:  # the integer exceeds Python's limit for printing
        return "a number of very many digits"

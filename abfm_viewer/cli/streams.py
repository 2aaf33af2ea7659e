"""What a program prints: it never ends the program, whoever reads it and in whatever encoding."""

import io
import os
import sys
from typing import Any, TextIO, cast


class LastingStream:
    """Prints to another stream until that fails; `problem` then says how, and the rest is
    dropped.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.problem: OSError | None = None
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        """Print a text."""
        if self.problem is None:
            try:
                self._stream.write(text)
            except OSError as error:
                self.problem = error
        return len(text)

    def flush(self) -> None:
        """Print what waits."""
        if self.problem is None:
            try:
                self._stream.flush()
            except OSError as error:
                self.problem = error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def lasting_streams() -> tuple[LastingStream, LastingStream]:
    """Make stdout and stderr such streams; those that whoever started the program has closed are
    /dev/null.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # takes the lowest number that is free: else a result might get it
            opened = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(opened, True)
    # None: it was closed
    streams = (cast(TextIO | None, sys.stdout), 1), (cast(TextIO | None, sys.stderr), 2)
    out, errors = (
        LastingStream(stream or os.fdopen(number, "w", encoding="utf-8"))
        for stream, number in streams
    )
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, errors)
    return out, errors

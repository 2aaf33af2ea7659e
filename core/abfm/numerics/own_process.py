"""A Python process for work that keeps the interpreter to itself, as long as a window must answer meanwhile.

Both ends are ours: they speak pickle, each message after its length in bytes. Answers come through a socket where there
is one: it takes in a long one in a single call, without the interpreter, which a window that draws lends only once a
frame. A pipe asks for it again every 64 KiB.
"""

import math
import os
import pickle
import signal
import socket
import subprocess
import sys
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import IO, Any

_LENGTH = 8  # bytes, of a message's length
_SMALLEST = 15_000  # unknowns; cholespy factors fewer within a few frames of a window
_factored_apart: ContextVar[float] = ContextVar("unknowns of linear systems that are factored apart", default=math.inf)


@contextmanager
def factoring_apart(unknowns: float = _SMALLEST) -> Iterator[None]:
    """Factor linear systems of so many unknowns and more, or of fewer with long rows, in processes of their own.

    cholespy stops all threads while it factors: for seven seconds at 160,000 vertices. So what works beside a window
    works inside this block; it holds for this thread alone, and what others do stays as it is.
    """
    before = _factored_apart.set(unknowns)
    try:
        yield
    finally:
        _factored_apart.reset(before)


def is_factored_apart(unknowns: float) -> bool:
    """Whether this thread has asked for it, for systems of this size."""
    return unknowns >= _factored_apart.get()


class ProcessEndedError(Exception):
    """The other process has ended, by `OwnProcess.close` or from outside."""


class OwnProcess:
    """Runs ``python -m module``, which serves `Requests`, until it is closed or nothing refers to it any more.

    Parameters
    ----------
    module : str
        Its name, dotted.
    """

    def __init__(self, module: str) -> None:
        command = [sys.executable, "-m", module]
        if sys.platform == "win32":  # where a process cannot have a socket for its output
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            assert self._process.stdout is not None
            self._read: Callable[[memoryview], int] = self._process.stdout.readinto
        else:
            answers, theirs = socket.socketpair()
            with theirs:
                self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=theirs.fileno())
            self._read = lambda buffer: answers.recv_into(buffer, 0, socket.MSG_WAITALL)
        self._end = weakref.finalize(self, _end, self._process)

    def send(self, message: object) -> None:
        """Send one message.

        Raises
        ------
        ProcessEndedError
            If nobody is there to read it.
        """
        assert self._process.stdin is not None
        try:
            _send(self._process.stdin, message)
        except (OSError, ValueError) as error:  # a pipe that is broken, or closed by `close`
            raise ProcessEndedError from error

    def receive(self) -> Any:
        """Wait, while other threads go on, for one message.

        Raises
        ------
        ProcessEndedError
            If none will come.
        """
        try:
            return _receive(self._read)
        except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
            raise ProcessEndedError from error

    def close(self) -> None:
        """End the process at once; also while another thread waits for it."""
        self._end()


class Requests:
    """The process's end: iterate over the requests and answer each. Ctrl-C is the other end's business."""

    def __init__(self) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        self._requests, self._answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # what libraries print must not mix with the answers

    def __iter__(self) -> Iterator[Any]:
        while True:
            try:
                yield _receive(self._requests.readinto)
            except (EOFError, pickle.UnpicklingError):  # the other end is gone, perhaps in the middle of a message
                return

    def answer(self, message: object) -> None:
        """Send the answer to the latest request."""
        _send(self._answers, message)


def _send(pipe: IO[bytes], message: object) -> None:
    content = pickle.dumps(message, protocol=5)
    pipe.write(len(content).to_bytes(_LENGTH))
    pipe.write(content)
    pipe.flush()


def _receive(read: Callable[[memoryview], int]) -> Any:
    """One message; `read` fills a buffer, or its beginning."""
    return pickle.loads(_filled(read, int.from_bytes(_filled(read, _LENGTH))))


def _filled(read: Callable[[memoryview], int], size: int) -> memoryview:
    """So many bytes; EOFError if fewer come."""
    content, start = memoryview(bytearray(size)), 0
    while start < size:
        count = read(content[start:])
        if not count:
            raise EOFError
        start += count
    return content


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    assert process.stdin is not None
    with suppress(OSError, ValueError):  # what nobody read, which Python would else report when it forgets the pipe
        process.stdin.close()

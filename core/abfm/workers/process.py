"""A process of our own, and the messages that go to it and come back: pickles after their length.

Answers come through a socket where there is one: it takes in a long one in a single call, without
the interpreter, which a window that draws lends only once a frame. A pipe asks for it again every
64 KiB.
"""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import IO, Any

_LENGTH = 8  # bytes, of a message's length
_running: weakref.WeakSet[subprocess.Popen[bytes]] = weakref.WeakSet()


class ProcessEndedError(Exception):
    """The other process has ended, by `ChildProcess.close` or from outside."""


class ChildProcess:
    """Runs ``python -m module``, which serves `Requests`, until it is closed or nothing refers to
    it any more. Not by `multiprocessing`, whose new processes run the user's script again.

    Its environment is this process's, with some variables changed.
    """

    def __init__(self, module: str, environment: Mapping[str, str] | None = None) -> None:
        command, variables = [sys.executable, "-m", module], os.environ | (environment or {})
        # In a group of its own: Ctrl-C on a terminal, which goes to a whole group, is this end's
        # business.
        pipe = subprocess.PIPE
        if sys.platform == "win32":  # where a process cannot have a socket for its output
            group = subprocess.CREATE_NEW_PROCESS_GROUP
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, creationflags=group, env=variables
            )
            assert self._process.stdout is not None
            received: IO[bytes] | socket.socket = self._process.stdout
            self._read: Callable[[memoryview], int] = self._process.stdout.readinto
        else:
            answers, theirs = socket.socketpair()
            with theirs:
                self._process = subprocess.Popen(
                    command, stdin=pipe, stdout=theirs.fileno(), process_group=0, env=variables
                )
            received = answers
            self._read = lambda buffer: answers.recv_into(buffer, 0, socket.MSG_WAITALL)
        self._receiving = threading.RLock()
        self.close = weakref.finalize(self, _end, self._process, received, self._receiving)
        """End the process at once; also while another thread waits for it."""
        _running.add(self._process)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def send(self, message: object) -> None:
        """Send one message; ProcessEndedError if nobody is there to read it."""
        assert self._process.stdin is not None
        try:
            _send(self._process.stdin, message)
        except (OSError, ValueError) as error:  # a pipe that is broken, or closed by `close`
            raise ProcessEndedError from error

    def receive(self) -> Any:
        """Wait, while other threads go on, for one message; ProcessEndedError if none will come."""
        try:
            with self._receiving:
                return _receive(self._read)
        except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
            raise ProcessEndedError from error


def kill_all() -> None:
    """End all that run, at once: for a process that ends itself so."""
    for process in list(_running):
        process.kill()


class Requests:
    """The process's end: requests to iterate over, until the other end is gone, and answers."""

    def __init__(self) -> None:
        self._requests, self._answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # what libraries print must not mix with the answers

    def __iter__(self) -> Iterator[Any]:
        # the other end is gone, perhaps in the middle of a message
        with suppress(EOFError, pickle.UnpicklingError):
            while True:
                yield _receive(self._requests.readinto)

    def answer(self, message: object) -> None:
        """Send one message; BrokenPipeError if the other end is gone."""
        _send(self._answers, message)


def _send(pipe: IO[bytes], message: object) -> None:
    content = pickle.dumps(message, protocol=5)
    pipe.write(len(content).to_bytes(_LENGTH))
    pipe.write(content)
    pipe.flush()


def _receive(read: Callable[[memoryview], int]) -> Any:
    """Read one message; `read` fills a buffer, or its beginning."""
    return pickle.loads(_read_exactly(read, int.from_bytes(_read_exactly(read, _LENGTH))))


def _read_exactly(read: Callable[[memoryview], int], size: int) -> memoryview:
    """Read so many bytes; EOFError if fewer come."""
    content, start = memoryview(bytearray(size)), 0
    while start < size:
        if not (count := read(content[start:])):
            raise EOFError
        start += count
    return content


def _end(
    process: subprocess.Popen[bytes],
    received: IO[bytes] | socket.socket,
    receiving: threading.RLock,
) -> None:
    process.kill()
    process.wait()
    # Whoever waits is told first that nothing will come: the number of what is closed is soon
    # another's.
    with receiving:
        received.close()
    assert process.stdin is not None
    # what nobody read, which Python would else report when it forgets the pipe
    with suppress(OSError, ValueError):
        process.stdin.close()

"""A child process, and the messages to and from it: pickles preceded by their length.

Answers are received through a socket where the platform has one. A socket receives a long answer in
a single call without Python's interpreter lock, which a drawing window releases only once per
frame. A pipe needs the lock every 64 KiB.
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

_LENGTH_BYTES = 8  # size of the length before each message
_running: weakref.WeakSet[subprocess.Popen[bytes]] = weakref.WeakSet()


class ProcessEndedError(Exception):
    """The child process has ended, by `ChildProcess.close` or from outside."""


class ChildProcess:
    """Runs ``python -m module``, which serves `Requests`, until it is closed or garbage-collected.

    The environment of the child is that of this process with some variables changed.
    `multiprocessing` is not used because its new processes run the user's script again.
    """

    def __init__(self, module: str, environment: Mapping[str, str] | None = None) -> None:
        command, variables = [sys.executable, "-m", module], os.environ | (environment or {})
        pipe, group = subprocess.PIPE, separate_group()
        if sys.platform == "win32":  # a process cannot have a socket for its output there
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, env=variables, **group
            )
            assert self._process.stdout is not None
            received: IO[bytes] | socket.socket = self._process.stdout
            self._read: Callable[[memoryview], int] = self._process.stdout.readinto
        else:
            answers, theirs = socket.socketpair()
            with theirs:
                self._process = subprocess.Popen(
                    command, stdin=pipe, stdout=theirs.fileno(), env=variables, **group
                )
            received = answers
            self._read = lambda buffer: answers.recv_into(buffer, 0, socket.MSG_WAITALL)
        self._receiving = threading.RLock()
        self.close = weakref.finalize(self, _end, self._process, received, self._receiving)
        """End the process at once, even while another thread waits for it."""
        _running.add(self._process)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def send(self, message: object) -> None:
        """Send one message; ProcessEndedError if the process has ended."""
        assert self._process.stdin is not None
        try:
            _send(self._process.stdin, message)
        except (OSError, ValueError) as error:  # a broken pipe, or one closed by `close`
            raise ProcessEndedError from error

    def receive(self) -> Any:
        """Wait for one message while other threads continue; ProcessEndedError if none arrives."""
        try:
            with self._receiving:
                return _receive(self._read)
        except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
            raise ProcessEndedError from error


def separate_group() -> dict[str, Any]:
    """Return options of `subprocess.Popen` for a process that Ctrl-C does not reach.

    A terminal sends Ctrl-C to a group of processes, and only the main process should handle it.
    """
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"process_group": 0}


def kill_all() -> None:
    """Kill all child processes at once, before this process ends without cleaning up."""
    for process in list(_running):
        process.kill()


class Requests:
    """The child's side: an iterator over requests until the parent ends, and a method to answer."""

    def __init__(self) -> None:
        self._requests, self._answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # output of libraries must not mix with the answers

    def __iter__(self) -> Iterator[Any]:
        # the parent has ended, perhaps in the middle of a message
        with suppress(EOFError, pickle.UnpicklingError):
            while True:
                yield _receive(self._requests.readinto)

    def answer(self, message: object) -> None:
        """Send one message; BrokenPipeError if the parent has ended."""
        try:
            _send(self._answers, message)
        except OSError as error:  # Windows reports an invalid argument
            raise BrokenPipeError from error


def _send(pipe: IO[bytes], message: object) -> None:
    content = pickle.dumps(message, protocol=5)
    pipe.write(len(content).to_bytes(_LENGTH_BYTES))
    pipe.write(content)
    pipe.flush()


def _receive(read: Callable[[memoryview], int]) -> Any:
    """Read one message with ``read``, which fills at least the beginning of a buffer."""
    return pickle.loads(_read_exactly(read, int.from_bytes(_read_exactly(read, _LENGTH_BYTES))))


def _read_exactly(read: Callable[[memoryview], int], size: int) -> memoryview:
    """Read ``size`` bytes; raise EOFError if there are fewer."""
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
    # A waiting thread must see the end of the stream before the socket is closed, because the
    # system soon reuses its file descriptor.
    with receiving:
        received.close()
    assert process.stdin is not None
    # closed here, as Python otherwise reports unread data when it destroys the pipe
    with suppress(OSError, ValueError):
        process.stdin.close()

"""Programs that tests run, and processes."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

ROOT = Path(__file__).parents[1]
_SECONDS_MAX = 600
_REFUSED_SECONDS_MAX = 120


def run(*words, **options):
    """Run a program with a time limit; return its exit status and output."""
    usual = {"capture_output": True, "text": True, "check": False, "timeout": _SECONDS_MAX}
    return subprocess.run(argv(*words), **usual | options)


def python(code, *words, **options):
    """Run a script in a fresh interpreter; see `run`."""
    return run(sys.executable, "-c", code, *words, **options)


def argv(*words):
    """Return the arguments of a command line as texts; a path with blanks is one argument."""
    return [*map(str, words)]


def words_of(line, **places):
    """Return the arguments of a command line; names in braces are paths that may have blanks."""
    return [word.format(**places) for word in line.split()]


@contextmanager
def refused_soon():
    """Make the test fail if a command that must be refused is still running after two minutes."""

    def fail(number, frame):
        pytest.fail("a command that must be refused was accepted")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(_REFUSED_SECONDS_MAX)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def children():
    """Return the ids of the running child processes."""
    found = set()
    for thread in Path(f"/proc/{os.getpid()}/task").iterdir():
        with suppress(OSError):  # it may have ended
            found.update((thread / "children").read_text().split())
    return found


def family(number):
    """Return the ids of a process and of its descendants."""
    with suppress(psutil.NoSuchProcess):
        return [number, *(each.pid for each in psutil.Process(number).children(recursive=True))]
    return [number]


def kill(number):
    """Kill a process if it exists."""
    with suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)


def lingering(numbers, seconds=20.0):
    """Wait at most ``seconds`` for processes to end; return the ids of those that still exist."""
    end = time.monotonic() + seconds
    while (
        left := [each for each in numbers if psutil.pid_exists(each)]
    ) and time.monotonic() < end:
        time.sleep(0.1)
    return left

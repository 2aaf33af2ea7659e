"""Programs that tests run, and what they say."""

import os
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run(*words, **options):
    """Run a program to its end and return its exit status and what it said."""
    usual = {"capture_output": True, "text": True, "check": False}
    return subprocess.run([*map(str, words)], **usual | options)


def python(code, *words, **options):
    """Run a script in a fresh interpreter; see `run`."""
    return run(sys.executable, "-c", code, *words, **options)


def argv(line):
    """Return the words of a command line as a shell makes them."""
    return shlex.split(line)


def children():
    """Numbers of the processes that this one has started and that have not ended."""
    found = set()
    for thread in Path(f"/proc/{os.getpid()}/task").iterdir():
        with suppress(OSError):  # it may have ended
            found.update((thread / "children").read_text().split())
    return found

"""Programs that tests run, and what they say."""

import shlex
import subprocess
import sys
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

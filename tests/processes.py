"""Programs that tests run, and what they say."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def run(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program to its end and return its exit status and what it said."""
    command = [str(word) for word in words]
    return subprocess.run(
        command, **{"capture_output": True, "text": True, "check": False} | options
    )


def python(code: str, *words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a script in a fresh interpreter; see `run`."""
    return run(sys.executable, "-c", code, *words, **options)


def argv(line: str) -> list[str]:
    """Return the words of a command line as a shell makes them."""
    return shlex.split(line)

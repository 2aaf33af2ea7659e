"""A part of the attack at work for some seconds, in a process of its own."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from tests.attack.trial import Trial

ROOT = Path(__file__).parents[2]
_PATIENCE = 600.0  # seconds without a line
_MANY = 10**6


class Slice:
    """The trials of a part from a seed on, as they end; what goes on when the time is over is
    waited for.
    """

    def __init__(self, part: str, seed: int, seconds: float, folder: Path) -> None:
        self._part, self._seed, self._seconds, self._folder = part, seed, seconds, folder

    def __iter__(self) -> Iterator[Trial]:
        said = self._folder / f"{self._part}-{self._seed}.log"
        words = ["--seed", str(self._seed), "--count", str(_MANY), "--seconds", str(self._seconds)]
        with said.open("w") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", f"tests.attack.{self._part}", *words],
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
                env=os.environ | {"TMPDIR": str(self._folder)},
            )
        lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=_read, args=(process, lines), daemon=True).start()
        following = self._seed
        try:
            while True:
                line = lines.get(timeout=_PATIENCE)
                if line is None:
                    if status := process.wait():
                        last = " ".join(said.read_text(errors="replace").strip().splitlines()[-1:])[
                            :200
                        ]
                        yield Trial(
                            "the part itself", following, "fault", f"exit status {status}: {last}"
                        )
                    return
                if line.startswith("{"):
                    trial = Trial.from_line(line)
                    following = trial.seed + 1
                    yield trial
        except queue.Empty:
            yield Trial("the part itself", following, "fault", f"no answer within {_PATIENCE:g} s")
        finally:
            _end(process)


def _read(process: subprocess.Popen[str], lines: queue.Queue[str | None]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put(None)


def _end(process: subprocess.Popen[str]) -> None:
    """End a part, should it still run, and what it has started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()

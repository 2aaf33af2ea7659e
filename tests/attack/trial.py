"""One trial of the attack, and the line in which a part of the attack tells of it.

A part is a module ``tests.attack.PART`` that runs as
``python -m tests.attack.PART --seed S --count N``: it makes the trials of the seeds S to S + N - 1,
each given by its seed alone, and prints the line of each as soon as it has ended. So
``--seed S --count 1`` repeats one exactly. With ``--seconds T`` it begins none later than that.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal

Outcome = Literal["ok", "refused", "fault"]


@dataclass(frozen=True)
class Trial:
    """What came of one seed.

    The kind says what was tried within the part (``"little.ply/bits"``); "ok" is that all went as
    promised, "refused" that bad input was refused in one line, "fault" anything else, with what
    went wrong as its detail. Seconds are of CPU time, megabytes what the process that was attacked
    grew by at most; threads and resident megabytes are what a process that goes on to the next
    trial has at the end. All are 0 where they were not measured.
    """

    kind: str
    seed: int
    outcome: Outcome
    detail: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0
    threads: int = 0
    resident: float = 0.0

    def to_line(self) -> str:
        """The line that a part prints."""
        return json.dumps(asdict(self))

    @classmethod
    def from_line(cls, line: str) -> Trial:
        """What `to_line` was asked of; only kind, seed and outcome must be there."""
        return cls(**json.loads(line))


def run(attempt: Callable[[int], Trial], about: str) -> None:
    """The main program of a part: makes the trials that the command line asks for."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--seed", type=int, default=0, help="of the first trial")
    parser.add_argument("--count", type=int, default=1, help="of trials, each with the next seed")
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="after which no trial begins"
    )
    asked = parser.parse_args()
    end = time.monotonic() + asked.seconds
    for seed in range(asked.seed, asked.seed + asked.count):
        if time.monotonic() > end:
            break
        print(attempt(seed).to_line(), flush=True)

"""A hunt for faults: hypothesis makes trials of one part of the attack, and faults are counted.

A part has a function that makes one trial with a `random.Random` that hypothesis controls. It
returns a `Trial` or raises a `FaultError`. Hypothesis numbers its runs by a seed, so that
``python -m tests.attack --repeat PART:SEED`` makes the same trials again and shrinks a fault.
"""

import random
from dataclasses import dataclass, field
from typing import NamedTuple

import hypothesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

_FAULTS_SHOWN = 20


class Trial(NamedTuple):
    """A trial without a fault; ``is_refused`` for bad input that was refused in one line."""

    is_refused: bool = False
    seconds: float = 0.0
    megabytes: float = 0.0


class FaultError(AssertionError):
    """A broken promise: what was tried, and what came of it."""


@dataclass
class Tally:
    """Counts of one part, its largest time and memory, and its faults by the seed of each."""

    part: str
    trials: int = 0
    refused: int = 0
    seconds: float = 0.0
    megabytes: float = 0.0
    faults: dict[str, str] = field(default_factory=dict)

    def add(self, trial):
        self.trials += 1
        self.refused += trial.is_refused
        self.seconds = max(self.seconds, trial.seconds)
        self.megabytes = max(self.megabytes, trial.megabytes)

    def row(self):
        numbers = (self.trials, self.refused, len(self.faults))
        return [self.part, *map(str, numbers), f"{self.seconds:.2g}", f"{self.megabytes:.0f}"]


def hunt(tally, attempt, seed, trials=40, shrinks=False):
    """Make the trials of a seed, the same ones each time, and add what comes of them to a tally.

    Only trials whose course depends on nothing else can be shrunk: hypothesis makes all choices of
    these. Other trials get a generator whose seed hypothesis chooses.
    """

    def one(chance):
        try:
            tally.add(attempt(chance))
        except FaultError as fault:
            if shrinks:
                raise
            tally.trials += 1
            tally.faults.setdefault(f"{tally.part}:{seed}", str(fault))

    phases = (Phase.generate, Phase.shrink) if shrinks else (Phase.generate,)
    whole = st.randoms(use_true_random=False)
    chances = whole if shrinks is not None else st.integers(0, 2**63).map(random.Random)
    test = given(chances)(one)
    test = settings(
        max_examples=trials,
        deadline=None,
        database=None,
        phases=phases,
        report_multiple_bugs=False,
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )(hypothesis.seed(seed)(test))
    try:
        test()
    except FaultError as fault:
        tally.faults[f"{tally.part}:{seed}"] = str(fault)


def table(tallies):
    """Lines for the terminal, the faults below."""
    heads = ("part", "trials", "refused", "faults", "longest (s)", "most memory (MB)")
    rows = [heads, *(tally.row() for tally in tallies)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.rjust, row, widths)) for row in rows]
    for tally in tallies:
        for place, what in list(tally.faults.items())[:_FAULTS_SHOWN]:
            lines.append(f"python -m tests.attack --repeat {place}\n    {what[:600]}")
    return "\n".join(lines)

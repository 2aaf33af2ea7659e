"""Search for faults: hypothesis makes trials of one part of the attack, and faults are counted.

A part has a function that makes one trial with a `random.Random` that hypothesis controls. It
returns a `Trial` or raises a `FaultError`. Hypothesis numbers its runs by a seed, so that ``python
-m tests.attack --repeat PART:SEED`` repeats the same trials and shrinks a fault.
"""

import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import hypothesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.attack.trial import FaultError
from tests.processes import ROOT

PARTS = {
    "mutations": 40,
    "hostile": 20,
    "signals": 2,
    "kills": 10,
    "memory": 2,
    "batches": 1,
    "monkey": 2,
}
"""Number of trials of each part per seed."""
SHRUNK = ("mutations", "hostile")


@dataclass
class Tally:
    """Results of one part: number of trials, largest time and memory, and faults by seed."""

    part: str
    trials: int = 0
    refused: int = 0
    seconds: float = 0.0
    megabytes: float = 0.0
    faults: dict[str, str] = field(default_factory=dict)

    def include(self, other):
        self.trials += other.trials
        self.refused += other.refused
        self.seconds = max(self.seconds, other.seconds)
        self.megabytes = max(self.megabytes, other.megabytes)
        self.faults |= other.faults

    def row(self):
        numbers = (self.trials, self.refused, len(self.faults))
        return [self.part, *map(str, numbers), f"{self.seconds:.2g}", f"{self.megabytes:.0f}"]


def hunt(tally, attempt, seed, trials=40, shrinks=False):
    """Make the trials that a seed determines, and add their results to a tally.

    Faults are shrunk only in parts whose trials depend only on the seed.
    """

    def one(chance):
        try:
            tally.include(Tally(tally.part, 1, *attempt(chance)))
        except FaultError as fault:
            if shrinks:
                raise
            tally.trials += 1
            tally.faults.setdefault(f"{tally.part}:{seed}", str(fault))

    chances = st.randoms(use_true_random=tally.part in {*PARTS} - {*SHRUNK})
    test = settings(
        deadline=None,
        database=None,
        print_blob=False,
        report_multiple_bugs=False,
        max_examples=trials,
        phases=(Phase.generate, Phase.shrink) if shrinks else (Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )(hypothesis.seed(seed)(given(chances)(one)))
    try:
        test()
    except FaultError as fault:
        tally.faults[f"{tally.part}:{seed}"] = str(fault)


def attempt_of(part, opened):
    """Return the function that makes one trial of a part; `opened` closes its resources."""
    if part in SHRUNK:
        from tests.attack import hostile, mutations
        from tests.attack.victim import Victim

        make = {"mutations": mutations.mutant, "hostile": hostile.hostile}[part]
        victim = opened.enter_context(Victim(ROOT / "out" / "attack"))
        return lambda chance: victim.open(*make(chance))
    if part == "monkey":
        from tests.attack.monkey import Monkey

        return opened.enter_context(Monkey()).attempt
    from tests.attack import processes

    if part == "memory":
        return processes.lack_memory
    folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="abfm-attack-")))
    return getattr(processes, part.title())(folder).attempt


def run_part(part, seed, seconds, shrinks=False):
    """Make the trials of a seed and of the following ones, for a number of seconds."""
    tally, end = Tally(part), time.monotonic() + seconds
    with ExitStack() as opened:
        attempt = attempt_of(part, opened)
        for each in count(seed):
            hunt(tally, attempt, each, PARTS[part], shrinks and part in SHRUNK)
            if time.monotonic() >= end:
                break
    return tally


def table(tallies):
    """Return a table of the parts as text for the terminal, followed by the faults."""
    heads = ("part", "trials", "refused", "faults", "longest (s)", "most memory (MB)")
    rows = [heads, *(tally.row() for tally in tallies)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.rjust, row, widths)) for row in rows]
    for tally in tallies:
        for place, what in list(tally.faults.items())[:20]:
            lines.append(f"python -m tests.attack --repeat {place}\n    {what[:600]}")
    return "\n".join(lines)

"""One trial of the attack, the line in which a part of it tells of one, and what they add up
to: a table for the terminal and for the page docs/promises.md, where it adds up over all runs.

A part is a module ``tests.attack.PART`` that runs as
``python -m tests.attack.PART --seed S --count N``: it makes the trials of the seeds S to S + N - 1,
each given by its seed alone, and prints the line of each as soon as it has ended. So
``--seed S --count 1`` repeats one exactly. With ``--seconds T`` it begins none later than that.
"""

import argparse
import json
import time
from dataclasses import asdict, dataclass, field

from tests.processes import ROOT

PAGE, TOTALS = ROOT / "docs" / "promises.md", ROOT / "docs" / "attack.json"
BEGIN, END = "<!-- table of ./run attack -->", "<!-- end of the table -->"
_HEADS = (
    *("part", "trials", "as promised", "refused in one line", "faults", "longest (s)"),
    "most memory (MB)",
)
_KEPT = 20  # faults that are told; of more there is only the number


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
    outcome: str
    detail: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0
    threads: int = 0
    resident: float = 0.0

    def to_line(self):
        """The line that a part prints."""
        return json.dumps(asdict(self))

    @classmethod
    def from_line(cls, line):
        """What `to_line` was asked of; only kind, seed and outcome must be there."""
        return cls(**json.loads(line))


@dataclass
class Tally:
    """Counts of one part, its worst time and memory, and its faults."""

    part: str
    ok: int = 0
    refused: int = 0
    fault_count: int = 0
    seconds: float = 0.0
    megabytes: float = 0.0
    faults: list[tuple[str, str]] = field(default_factory=list)

    @property
    def trials(self):
        return self.ok + self.refused + self.fault_count

    def add(self, trial):
        """Count one more."""
        self.ok += trial.outcome == "ok"
        self.refused += trial.outcome == "refused"
        self.fault_count += trial.outcome == "fault"
        self.seconds = max(self.seconds, trial.seconds)
        self.megabytes = max(self.megabytes, trial.megabytes)
        if trial.outcome == "fault" and len(self.faults) < _KEPT:
            command = f"./run attack --repeat {self.part}:{trial.seed}"
            self.faults.append((command, f"{trial.kind}: {trial.detail}"))


def asked_for(about, **options):
    """What the command line of a part asks for, which may have switches of its own."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--seed", type=int, default=0, help="of the first trial")
    parser.add_argument("--count", type=int, default=1, help="of trials, each with the next seed")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no trial begins later")
    for name, settings in options.items():
        parser.add_argument(f"--{name}", **settings)
    return parser.parse_args()


def run(attempt, about):
    """The main program of a part: makes the trials that the command line asks for."""
    asked = asked_for(about)
    end = time.monotonic() + asked.seconds
    for seed in range(asked.seed, asked.seed + asked.count):
        if time.monotonic() > end:
            break
        print(attempt(seed).to_line(), flush=True)


def _row(tally):
    counts = [f"{count:,}" for count in (tally.trials, tally.ok, tally.refused, tally.fault_count)]
    measured = [f"{n:.2g}" if 0 < n < 10 else f"{n:.0f}" for n in (tally.seconds, tally.megabytes)]
    return [tally.part.replace("_", " "), *counts, *("" if n == "0" else n for n in measured)]


def text_table(tallies):
    """Lines for the terminal, the faults below."""
    rows = [_HEADS, *map(_row, tallies.values())]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.rjust, row, widths)) for row in rows]
    for tally in tallies.values():
        lines += [f"{command}\n    {detail}" for command, detail in tally.faults]
        if tally.fault_count > len(tally.faults):
            lines.append(f"... and {tally.fault_count - len(tally.faults)} more of {tally.part}")
    return "\n".join(lines)


def write(tallies):
    """Add the numbers to those of earlier runs, and write the page's table anew."""
    known = json.loads(TOTALS.read_text(encoding="utf-8")) if TOTALS.exists() else {}
    totals = {part: Tally(part, **numbers) for part, numbers in known.items()}
    for part, tally in tallies.items():
        total = totals.setdefault(part, Tally(part))
        for count in ("ok", "refused", "fault_count"):
            setattr(total, count, getattr(total, count) + getattr(tally, count))
        for worst in ("seconds", "megabytes"):
            setattr(total, worst, max(getattr(total, worst), getattr(tally, worst)))
        found = [(command, detail.replace(f"{ROOT}/", "")) for command, detail in tally.faults]
        total.faults = list(dict.fromkeys([*map(tuple, total.faults), *found]))
    plain = {part: {k: v for k, v in vars(t).items() if k != "part"} for part, t in totals.items()}
    TOTALS.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{BEGIN}\n\n{_markdown(totals)}\n\n{END}{after}", encoding="utf-8")


def _markdown(totals):
    """The table, and the faults that were found on the way."""
    rows = [_HEADS, ["---"] * len(_HEADS), *map(_row, totals.values())]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    faults = [fault for total in totals.values() for fault in total.faults]
    if faults:
        lines += ["", "What was found on the way:", ""]
        lines += [f"- `{command}`: {detail[:150]}" for command, detail in faults]
    return "\n".join(lines)

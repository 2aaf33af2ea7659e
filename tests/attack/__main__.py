"""Try to break abfm for some minutes, on all cores, and print a table of what came of it.

The exit status is 1 if there is a fault. Files that made one are in ``out/attack``.
"""

import argparse
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

from tests.attack.hunt import Tally, hunt, table
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
"""The parts, and the trials of each that a seed makes."""
SHRUNK = ("mutations", "hostile")
_RUN_SECONDS = 60.0  # of one part in one process


def attempt_of(part, opened):
    """Return the function that makes one trial of a part; what it needs is closed at the end."""
    if part in ("mutations", "hostile"):
        from tests.attack import hostile, mutations
        from tests.attack.victim import Victim

        make = {"mutations": mutations.mutant, "hostile": hostile.hostile}[part]
        victim = opened.enter_context(Victim(ROOT / "out" / "attack"))
        return lambda chance: victim.open(*make(chance))
    if part == "monkey":
        from tests.attack.monkey import Monkey

        return opened.enter_context(Monkey()).attempt
    from tests.attack import batches, processes

    if part == "memory":
        return processes.lack_memory
    folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="abfm-attack-")))
    makers = {"signals": processes.Signals, "kills": processes.Kills, "batches": batches.Batches}
    return makers[part](folder).attempt


def run_part(part, seed, seconds, shrinks=False):
    """Make the trials of a seed and of those after it, for so many seconds."""
    tally, end = Tally(part), time.monotonic() + seconds
    with ExitStack() as opened:
        attempt = attempt_of(part, opened)
        while time.monotonic() < end or not tally.trials:
            hunt(tally, attempt, seed, PARTS[part], shrinks if part in SHRUNK else None)
            seed += 1
            if shrinks:
                break
    return tally


def main():
    """The program; its exit status."""
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__)
    add = parser.add_argument
    add("--minutes", type=float, default=10, help="how long (default: 10)")
    add("--seed", type=int, help="of the first trials (default: another one each time)")
    add("--workers", type=int, default=os.cpu_count() or 1, help="at a time (default: one a core)")
    add("--only", choices=PARTS, action="append", help="this part alone; may be repeated")
    add("--repeat", metavar="PART:SEED", help="make the trials of a seed again, and shrink a fault")
    add("--json", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.repeat:
        part, _, seed = asked.repeat.rpartition(":")
        if part not in PARTS or not seed.isdecimal():
            parser.error(f"--repeat {asked.repeat}: expected one of {', '.join(PARTS)}, and a seed")
        tallies = [run_part(part, int(seed), float("inf"), shrinks=True)]
    elif asked.json:
        print(json.dumps(vars(run_part(asked.only[0], asked.seed, 60 * asked.minutes))))
        return 0
    else:
        seed = secrets.randbelow(10**6) * 10**3 if asked.seed is None else asked.seed
        tallies = attack(asked.only or list(PARTS), asked.minutes * 60, seed, asked.workers)
    print(table(tallies))
    return int(any(tally.faults for tally in tallies))


def attack(parts, seconds, seed, workers):
    """Run the parts in turn in processes of their own, and add up what comes of them."""
    end, tallies = time.monotonic() + seconds, {part: Tally(part) for part in parts}

    def work(number):
        turn = number
        while (left := end - time.monotonic()) > 0:
            part = parts[turn % len(parts)]
            _add(tallies[part], _run(part, seed + 1000 * turn, min(_RUN_SECONDS, left)))
            turn += workers

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(workers)))
    return list(tallies.values())


def _run(part, seed, seconds):
    words = ["--json", "--only", part, "--seed", str(seed), "--minutes", str(seconds / 60)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.attack", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    with suppress(ValueError, IndexError):
        return Tally(**json.loads(done.stdout.splitlines()[-1]))
    last = " ".join(done.stderr.splitlines()[-3:])[-300:]
    return Tally(part, faults={f"{part}:{seed}": f"the attack itself: {done.returncode}: {last}"})


def _add(tally, other):
    tally.trials += other.trials
    tally.refused += other.refused
    tally.seconds = max(tally.seconds, other.seconds)
    tally.megabytes = max(tally.megabytes, other.megabytes)
    tally.faults |= other.faults


if __name__ == "__main__":
    sys.exit(main())

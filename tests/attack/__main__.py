"""Attack on abfm for some minutes, on all cores, with a table of the results.

The exit status is 1 if there is a fault. Files with a fault are stored in ``out/attack``.
"""

import argparse
import os
import secrets
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

from tests.attack.hunt import PARTS, Tally, run_part, table

_RUN_SECONDS = 60.0  # of one part in one process


def attack(parts, seconds, seed, workers):
    """Run the parts in turn, each time in a new process, and add up their results."""
    end, tallies = time.monotonic() + seconds, {part: Tally(part) for part in parts}

    def work(turn):
        while (left := end - time.monotonic()) > 0:
            part, first = parts[turn % len(parts)], seed + 1000 * turn
            with ProcessPoolExecutor(1, get_context("spawn")) as alone:
                done = alone.submit(run_part, part, first, min(_RUN_SECONDS, left))
            if error := done.exception():
                found = {f"{part}:{first}": f"the attack itself: {error!r}"}
                tallies[part].include(Tally(part, faults=found))
            else:
                tallies[part].include(done.result())
            turn += workers

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(workers)))
    return list(tallies.values())


def main():
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__)
    add = parser.add_argument
    add("--minutes", type=float, default=10, help="how long (default: 10)")
    add("--seed", type=int, help="of the first trials (default: another one each time)")
    add("--workers", type=int, default=os.cpu_count() or 1, help="at a time (default: one a core)")
    add("--only", choices=PARTS, action="append", help="this part alone; may be repeated")
    add("--repeat", metavar="PART:SEED", help="make the trials of a seed again, and shrink a fault")
    options = parser.parse_args()
    if options.repeat:
        part, _, seed = options.repeat.rpartition(":")
        if part not in PARTS or not seed.isdecimal():
            names = ", ".join(PARTS)
            parser.error(f"--repeat {options.repeat}: expected one of {names}, and a seed")
        tallies = [run_part(part, int(seed), 0, shrinks=True)]
    else:
        seed = secrets.randbelow(10**6) * 10**3 if options.seed is None else options.seed
        tallies = attack(options.only or list(PARTS), options.minutes * 60, seed, options.workers)
    print(table(tallies))
    return int(any(tally.faults for tally in tallies))


if __name__ == "__main__":
    sys.exit(main())

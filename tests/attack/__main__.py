"""All parts of the attack for some minutes, on all cores, and a table of what came of it.

The exit status is 1 where there is a fault. Files that made one are in ``out/attack``.
"""

from __future__ import annotations

import argparse
import os
import secrets
import subprocess
import sys
import threading
import time
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.attack import promises
from tests.attack.slices import Slice
from tests.attack.tally import Tally

SHARES = {
    "mutations": 3,
    "hostile": 1,
    "broken_meshes": 2,
    "signals": 4,
    "kills": 1,
    "monkey": 8,
    "memory": 1,
}
"""The parts, modules of this package, and the time that each has in relation to the others."""
_SEEDS = 10**6  # of one worker, for one part


def parts() -> list[str]:
    """Those that are there."""
    return [part for part in SHARES if find_spec(f"tests.attack.{part}")]


def main() -> int:
    """The program; its exit status."""
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10, help="how long (default: 10)")
    parser.add_argument(
        "--seed", type=int, help="of the first trial of every part (default: another one each time)"
    )
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="at a time (default: one per core)"
    )
    parser.add_argument(
        "--only", choices=parts(), action="append", help="this part alone; may be repeated"
    )
    parser.add_argument(
        "--repeat", metavar="PART:SEED", help="repeat one trial and say what came of it"
    )
    parser.add_argument(
        "--write", action="store_true", help="add the numbers to the table of docs/promises.md"
    )
    asked = parser.parse_args()
    if asked.repeat:
        part, _, seed = asked.repeat.rpartition(":")
        if part not in parts() or not seed.isdecimal():
            parser.error(
                f"--repeat {asked.repeat}: expected a part ({', '.join(parts())}), a colon and a "
                "seed"
            )
        return subprocess.call([sys.executable, "-m", f"tests.attack.{part}", "--seed", seed])
    seed = secrets.randbelow(10**6) * 10**3 if asked.seed is None else asked.seed
    tallies = attack(asked.only or parts(), asked.minutes * 60, seed, asked.workers)
    print(promises.text_table(tallies))
    if asked.write:
        promises.write(tallies)
    return int(any(tally.faults for tally in tallies.values()))


def attack(chosen: list[str], seconds: float, seed: int, workers: int) -> dict[str, Tally]:
    """What came of each part in so many seconds."""
    tallies = {part: Tally(part) for part in chosen}
    spent = dict.fromkeys(chosen, 0.0)
    lock, end = threading.Lock(), time.monotonic() + seconds
    longest = max(seconds / 12, 5.0)

    def work(worker: int, folder: Path) -> None:
        following = dict.fromkeys(chosen, seed + worker * _SEEDS)
        while (left := end - time.monotonic()) > 0:
            with lock:
                part = min(chosen, key=lambda part: spent[part] / SHARES[part])
                planned = min(longest * SHARES[part] / 2, left)
                spent[part] += planned
            begin = time.monotonic()
            for trial in Slice(part, following[part], planned, folder):
                following[part] = trial.seed + 1
                with lock:
                    tallies[part].add(trial)
                    _show(tallies, end)
            with lock:
                spent[part] += time.monotonic() - begin - planned

    with TemporaryDirectory(prefix="abfm-attack-") as folder:
        threads = [
            threading.Thread(target=work, args=(number, Path(folder))) for number in range(workers)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    print(file=sys.stderr)
    return tallies


_shown = 0.0


def _show(tallies: dict[str, Tally], end: float) -> None:
    """The line of progress, at most once a second; once a minute where there is no terminal."""
    global _shown
    now, terminal = time.monotonic(), sys.stderr.isatty()
    if now - _shown < (1 if terminal else 60):
        return
    _shown = now
    counts = ", ".join(
        f"{tally.part} {tally.trials} ({tally.fault_count})" for tally in tallies.values()
    )
    line = f"{max(end - now, 0) / 60:.1f} min left; trials (faults): {counts}"
    print(
        f"\r\033[K{line}" if terminal else line,
        end="" if terminal else "\n",
        file=sys.stderr,
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())

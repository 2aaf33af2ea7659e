"""All parts of the attack for some minutes, on all cores, and a table of what came of it.

The exit status is 1 where there is a fault. Files that made one are in ``out/attack``.
"""

import argparse
import os
import queue
import secrets
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.attack.trial import Tally, Trial, text_table, write
from tests.processes import ROOT

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
_MANY = 10**6  # seeds of one worker, for one part
_PATIENCE = 600.0  # seconds without a line


def main():
    """The program; its exit status."""
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__)
    add, cores = parser.add_argument, os.cpu_count() or 1
    add("--minutes", type=float, default=10, help="how long (default: 10)")
    add("--seed", type=int, help="of each part's first trial (default: another one each time)")
    add("--workers", type=int, default=cores, help="at a time (default: one per core)")
    add("--only", choices=SHARES, action="append", help="this part alone; may be repeated")
    add("--repeat", metavar="PART:SEED", help="repeat one trial and say what came of it")
    add("--write", action="store_true", help="add the numbers to the table of docs/promises.md")
    asked = parser.parse_args()
    if asked.repeat:
        part, _, seed = asked.repeat.rpartition(":")
        if part not in SHARES or not seed.isdecimal():
            parts = ", ".join(SHARES)
            parser.error(f"--repeat {asked.repeat}: expected a part ({parts}), a colon and a seed")
        return subprocess.call([sys.executable, "-m", f"tests.attack.{part}", "--seed", seed])
    seed = secrets.randbelow(10**6) * 10**3 if asked.seed is None else asked.seed
    tallies = attack(asked.only or list(SHARES), asked.minutes * 60, seed, asked.workers)
    print(text_table(tallies))
    if asked.write:
        write(tallies)
    return int(any(tally.faults for tally in tallies.values()))


def attack(chosen, seconds, seed, workers):
    """What came of each part in so many seconds."""
    tallies = {part: Tally(part) for part in chosen}
    spent = dict.fromkeys(chosen, 0.0)
    lock, end = threading.Lock(), time.monotonic() + seconds
    longest = max(seconds / 12, 5.0)
    shown = 0.0

    def show():
        """The line of progress, at most once a second; once a minute where no terminal is."""
        nonlocal shown
        now, terminal = time.monotonic(), sys.stderr.isatty()
        if now - shown < (1 if terminal else 60):
            return
        shown = now
        counts = ", ".join(f"{t.part} {t.trials} ({t.fault_count})" for t in tallies.values())
        line = f"{max(end - now, 0) / 60:.1f} min left; trials (faults): {counts}"
        before, after = ("\r\033[K", "") if terminal else ("", "\n")
        print(before + line, end=after, file=sys.stderr, flush=True)

    def work(worker, folder):
        following = dict.fromkeys(chosen, seed + worker * _MANY)
        while (left := end - time.monotonic()) > 0:
            with lock:
                part = min(chosen, key=lambda part: spent[part] / SHARES[part])
                planned = min(longest * SHARES[part] / 2, left)
                spent[part] += planned
            begin = time.monotonic()
            for trial in trials(part, following[part], planned, folder):
                following[part] = trial.seed + 1
                with lock:
                    tallies[part].add(trial)
                    show()
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


def trials(part, seed, seconds, folder):
    """The trials of a part from a seed on, as they end, in a process of its own."""
    said = folder / f"{part}-{seed}.log"
    words = ["--seed", str(seed), "--count", str(_MANY), "--seconds", str(seconds)]
    with said.open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", f"tests.attack.{part}", *words],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
            env=os.environ | {"TMPDIR": str(folder)},
        )
    lines = queue.Queue()

    def read():
        for line in process.stdout:
            lines.put(line)
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    try:
        while (line := lines.get(timeout=_PATIENCE)) is not None:
            if line.startswith("{"):
                trial = Trial.from_line(line)
                seed = trial.seed + 1
                yield trial
        if status := process.wait():
            last = " ".join(said.read_text(errors="replace").strip().splitlines()[-1:])[:200]
            yield Trial("the part itself", seed, "fault", f"exit status {status}: {last}")
    except queue.Empty:
        yield Trial("the part itself", seed, "fault", f"no answer within {_PATIENCE:g} s")
    finally:
        # end it, should it still run, and what it has started
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


if __name__ == "__main__":
    sys.exit(main())

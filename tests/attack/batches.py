"""Batches whose processes are killed at random moments: the client, the scheduler, a worker.

The batch goes on, solves nothing again that was done, and ends with the same files, bit for bit, as
one that nobody disturbed. Linux only.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import psutil

from abfm.assets import asset_path
from tests.attack.hunt import FaultError, Trial
from tests.processes import ROOT

_PROGRAM = "import sys; from abfm_viewer.cli import main; sys.exit(main())"
_ROWS, _KILLS, _SECONDS_MAX = 12, 3, 4.0


class Batches:
    """Kills processes of a batch that was solved undisturbed once."""

    def __init__(self, folder):
        self._folder, self._table = folder, folder / "table.csv"
        write_table(self._table, _ROWS, iterations=60)
        process = start(self._table, folder / "alone", "--quiet", "--jobs=1")
        process.communicate()
        self._wanted = results(folder / "alone")

    def attempt(self, chance):
        """Kill processes of a batch by two workers until it ends by itself."""
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            out, process = Path(place, "out"), None
            killed, done, there = [], {}, set()
            while process is None or process.returncode == -signal.SIGKILL:
                process = start(self._table, out, "--jobs=2")
                with suppress(subprocess.TimeoutExpired):
                    while True:
                        left = len(killed) < _KILLS
                        process.communicate(timeout=_SECONDS_MAX * chance.random() if left else 300)
                        break
                if process.poll() is None:
                    found = victims(process.pid)
                    there |= {*family(process.pid)}
                    done = written(out) | done
                    who = chance.choice([each for each in found if found[each]])
                    kill(chance.choice(found[who]))
                    killed.append(who)
                    if who != "client":
                        kill(process.pid)
                    process.communicate()
            faults = [f"{name[:8]} was solved again" for name in anew(done, written(out))]
            faults += [] if results(out) == self._wanted else ["other results than undisturbed"]
            faults += [f"process {each} is left" for each in lingering(there)]
        if process.returncode not in (0, 3) or faults:
            what = f"killed {', '.join(killed)}: exit status {process.returncode}"
            raise FaultError("; ".join([what, *faults]))
        return Trial()


def write_table(path, rows, seed=0, iterations=300):
    """Write a table of pairs of Gaussians on the figure eight, each another one."""
    mesh, count = asset_path("eight.off"), 315
    chosen = random.Random(seed).sample(range(count * (count - 1)), rows)
    lines = ["name,mesh,source,target,refine,iterations"]
    for number, place in enumerate(chosen):
        first, step = divmod(place, count - 1)
        ends = (first, (first + 1 + step) % count)
        functions = ",".join(f'"gaussian:vertex={end},width=0.3"' for end in ends)
        lines.append(f"pair {number},{mesh},{functions},0,{iterations}")
    path.write_text("\n".join(lines) + "\n")


def start(table, out, *words):
    """Start a client, whose processes have its number as their parent's."""
    return subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, "batch", table, "--out", out, "--no-pictures", *words],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def results(out):
    """Checksums of the results by name."""
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in out.glob("*.npz")}


def written(out):
    """Which file each result is, by name: another one if it was written again."""
    found = {}
    for path in out.glob("[!.]*.npz"):  # a temporary file is no result
        with suppress(OSError):
            state = path.stat()
            found[path.name] = (state.st_ino, state.st_mtime_ns)
    return found


def anew(before, after):
    """Names of results that were done before and were found once more, or are gone."""
    return sorted(name for name, file in before.items() if after.get(name) != file)


def family(number):
    """Return the numbers of a process and of all below it."""
    with suppress(psutil.NoSuchProcess):
        return [number, *(each.pid for each in psutil.Process(number).children(recursive=True))]
    return [number]


def victims(client):
    """Return numbers of processes by what they are: of the client and of its own cluster."""
    holders, workers = [], []
    with suppress(psutil.NoSuchProcess):
        holders = psutil.Process(client).children()
        below = [each for holder in holders for each in holder.children()]
        workers = [each.pid for each in below if "spawn_main" in " ".join(each.cmdline())]
    return {"client": [client], "scheduler": [each.pid for each in holders], "worker": workers}


def kill(number):
    with suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)


def lingering(numbers, seconds=20.0):
    """Return those of some processes that are still there after a while."""
    end = time.monotonic() + seconds
    while (
        left := [each for each in numbers if psutil.pid_exists(each)]
    ) and time.monotonic() < end:
        time.sleep(0.1)
    return left

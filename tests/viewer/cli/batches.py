"""Batches that run in subprocesses: their tables, results and processes."""

import random
import subprocess
import sys
from contextlib import suppress
from hashlib import sha256

import psutil

from abfm.assets import asset_path
from tests.processes import ROOT

MAIN = "import sys; from abfm_viewer.cli import main; sys.exit(main())"


def write_table(path, rows, seed=0, iterations=300):
    """Write a table of different pairs of Gaussians on the figure eight."""
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
    """Start a batch whose workers are children of the returned process."""
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, "batch", table, "--out", out, "--no-pictures", *words],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def results(out):
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in out.glob("*.npz")}


def written(out):
    """Return a value for each result file by name, which changes if the file is written again."""
    found = {}
    for path in out.glob("[!.]*.npz"):
        with suppress(OSError):
            state = path.stat()
            found[path.name] = (state.st_ino, state.st_mtime_ns)
    return found


def changed_results(before, after):
    """Return the names of earlier results that were written again, or that are missing."""
    return sorted(name for name, file in before.items() if after.get(name) != file)


def victims(client):
    """Return the process ids of a client of a batch and of its workers."""
    workers = []
    with suppress(psutil.NoSuchProcess):
        workers = [each.pid for each in psutil.Process(client).children()]
    return {"client": [client], "worker": workers}

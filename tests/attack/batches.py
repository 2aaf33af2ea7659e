"""A batch whose processes are killed at random moments: the client, the scheduler, a worker. It
goes on, finds nothing anew that was done, and ends with the same files, bit for bit, as one that
nobody touched.

    python -m tests.attack.batches --rows 200 --kills 10

runs it undisturbed by one and by two workers, which are timed, then with kills by processes of its
own, and then with kills on a cluster in another process (``--scheduler-file``). Linux only.
"""

import argparse
import json
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

from abfm.assets import asset_path
from tests.processes import ROOT

_PROGRAM = "import sys; from abfm_viewer.cli import main; sys.exit(main())"
_ELSEWHERE = """
import sys
import threading
import time
import dask
from distributed import LocalCluster
from abfm.batch.local_cluster import mend

def tend(cluster):
    while True:
        mend(cluster, 2)
        time.sleep(1)

if __name__ == "__main__":
    dask.config.set({"distributed.scheduler.allowed-failures": 2})
    dask.config.set({"distributed.scheduler.worker-saturation": 1.0})
    dask.config.set({"distributed.scheduler.worker-ttl": None})
    dask.config.set({"distributed.deploy.lost-worker-timeout": "1h"})
    cluster = LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    )
    with open(sys.argv[1] + ".new", "w") as file:
        import json
        json.dump(cluster.scheduler.identity(), file)
    import os
    os.replace(sys.argv[1] + ".new", sys.argv[1])
    threading.Thread(target=tend, args=(cluster,), daemon=True).start()
    sys.stdin.read()
"""
VICTIMS = ("client", "scheduler", "worker")


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


def children_of(number):
    """Numbers of the processes that a process has started."""
    found = []
    with suppress(OSError):
        for thread in Path(f"/proc/{number}/task").iterdir():
            found += map(int, (thread / "children").read_text().split())
    return found


def words_of(number):
    """The command line of a process; empty if it is gone."""
    with suppress(OSError):
        return Path(f"/proc/{number}/cmdline").read_text().replace("\0", " ")
    return ""


def family(number):
    """A process and all below it that are Python's."""
    return [number, *(each for child in children_of(number) for each in family(child))]


def victims(client, cluster=None):
    """Numbers of processes by what they are: those of a client's own cluster or of another one."""
    holders = [cluster] if cluster else children_of(client)
    workers = [
        each for holder in holders for each in children_of(holder) if "spawn_main" in words_of(each)
    ]
    return {"client": [client], "scheduler": holders, "worker": workers}


def kill(number):
    with suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)


def killed(table, out, kills, chance, longest, words=(), cluster=None):
    """Run a batch to its end while so many of its processes are killed, each at a random moment
    within so many seconds of the one before; who was killed, the last exit status, and the names
    of results that were there at a kill and were found anew.
    """
    told, done, process = [], {}, start(table, out, *words)
    while True:
        try:
            wait = longest * chance.random() if len(told) < kills else None
            process.communicate(timeout=wait)
        except subprocess.TimeoutExpired:
            found = victims(process.pid, cluster)
            if cluster:  # whose scheduler is not started anew by anybody
                del found["scheduler"]
            who = chance.choice([each for each in found if found[each]])
            done = written(out) | done
            kill(chance.choice(found[who]))
            told.append(who)
            continue
        if process.returncode != -signal.SIGKILL:
            return told, process.returncode, anew(done, written(out))
        process = start(table, out, *words)


def faults_of(out, wanted):
    """What is wrong with a folder of results that should be these."""
    found = results(out)
    faults = [f"{name[:8]} is missing" for name in wanted.keys() - found.keys()]
    faults += [f"{name[:8]} is too many" for name in found.keys() - wanted.keys()]
    faults += [
        f"{name[:8]} differs" for name in wanted if found.get(name, wanted[name]) != wanted[name]
    ]
    faults += [f"{each.name} is left" for each in out.rglob(".abfm-*")]
    return faults


def lingering(numbers, seconds=20.0):
    """Those of some processes that are still there after a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        left = [each for each in numbers if words_of(each)]
        if not left:
            return []
        time.sleep(0.1)
    return left


def elsewhere(file):
    """Start a cluster in a process of its own, and wait until its scheduler's file is there."""
    process = subprocess.Popen(
        [sys.executable, "-c", _ELSEWHERE, file],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    while not file.exists():
        assert process.poll() is None, "the cluster did not start"
        time.sleep(0.1)
    return process


def _timed(table, out, jobs):
    """Wall and processor seconds, of all its processes, of a batch that nobody touches."""
    began, spent = time.monotonic(), {}
    process = start(table, out, "--quiet", "--jobs", str(jobs))
    while process.poll() is None:
        for number in family(process.pid):
            with suppress(OSError):
                fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
                spent[number] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        time.sleep(0.2)
    wall = time.monotonic() - began
    assert process.returncode in (0, 3), process.communicate()[1]
    return {"jobs": jobs, "wall": round(wall, 1), "cpu": round(sum(spent.values()), 1)}


def main():
    """The program; its exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=200)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--iterations", type=int, default=300, help="of each match at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeat", type=int, default=1, help="timings, the best of which counts")
    asked = parser.parse_args()
    chance, faults = random.Random(asked.seed), []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        table = folder / "table.csv"
        write_table(table, asked.rows, asked.seed, asked.iterations)
        timings = []
        for number in range(asked.repeat):
            for jobs in (1, 2):
                out = folder / f"{jobs}-{number}"
                timings.append(_timed(table, out, jobs))
                print(json.dumps(timings[-1] | {"load": os.getloadavg()}), flush=True)
        wanted = results(folder / "1-0")
        faults += faults_of(folder / "2-0", wanted)
        best = {jobs: min(t["wall"] for t in timings if t["jobs"] == jobs) for jobs in (1, 2)}
        longest = 2 * best[2] / (asked.kills + 2)
        print(f"two workers are {best[1] / best[2]:.2f} times as fast as one", flush=True)
        told, status, twice = killed(table, folder / "killed", asked.kills, chance, longest)
        faults += faults_of(folder / "killed", wanted)
        faults += [f"{name[:8]} was done, and was found anew" for name in twice]
        print(f"killed {', '.join(told)}: exit status {status}", flush=True)
        file = folder / "scheduler.json"
        cluster = elsewhere(file)
        words = ("--scheduler-file", str(file))
        out = folder / "elsewhere"
        told, status, twice = killed(table, out, asked.kills, chance, longest, words, cluster.pid)
        faults += faults_of(out, wanted)
        faults += [f"{name[:8]} was done, and was found anew" for name in twice]
        print(f"elsewhere, killed {', '.join(told)}: exit status {status}", flush=True)
        there = family(cluster.pid)[1:]
        kill(cluster.pid)
        cluster.communicate()
        faults += [f"process {each} is left" for each in lingering(there)]
    print(f"{len(wanted)} results; {len(faults)} faults", *faults, sep="\n")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())

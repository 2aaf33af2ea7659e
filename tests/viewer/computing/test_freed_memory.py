"""Memory that was freed goes back to the system."""

from __future__ import annotations

import subprocess
import sys

_CHILD = """
import os
from pathlib import Path
from threading import Thread
from abfm_viewer.computing.freed_memory import give_back

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20

def work():  # in pieces that the C library keeps for itself, and one at the end that nobody frees
    pieces = [bytearray(100_000) for _ in range(1000)]
    kept.append(bytearray(100_000))

kept = []
thread = Thread(target=work)
thread.start()
thread.join()
before = resident()
give_back()
print(before - resident())
"""


def test_what_an_ended_thread_had_is_given_back():
    done = subprocess.run([sys.executable, "-c", _CHILD], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 50  # megabytes, of 100

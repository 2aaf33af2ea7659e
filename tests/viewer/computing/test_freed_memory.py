"""Memory that was freed goes back to the system."""

from tests.processes import python

_RESIDENT = """
import os
from pathlib import Path
from threading import Thread
from abfm_viewer.computing.freed_memory import return_free_memory, limit_pools

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20
"""

_PIECES = """
def work():  # in pieces that the C library keeps for itself, and one at the end that nobody frees
    pieces = [bytearray(100_000) for _ in range(1000)]
    kept.append(bytearray(100_000))

kept = []
thread = Thread(target=work)
thread.start()
thread.join()
before = resident()
return_free_memory()
print(before - resident())
"""


_BLOCKS = """
# freed at once: from now on the C library would take blocks up to this size from its pools
bytearray(30 << 20)
limit_pools()
before = resident()
kept = []
for _ in range(20):
    kept += [bytearray(5 << 20), bytearray(100_000)]  # small ones keep the pool from shrinking
del kept[::2]
print(resident() - before)
"""


def test_what_an_ended_thread_had_is_given_back_and_large_blocks_when_they_are_freed():
    given, kept = (
        float(python(_RESIDENT + program, check=True).stdout) for program in (_PIECES, _BLOCKS)
    )
    assert given > 50  # megabytes, of 100
    assert kept < 20

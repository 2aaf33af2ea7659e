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
def work():  # in pieces that the C library caches, and a last one that is never freed
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
# by default the C library then takes blocks up to this size from its pools
bytearray(30 << 20)
limit_pools()
before = resident()
kept = []
for _ in range(20):
    kept += [bytearray(5 << 20), bytearray(100_000)]  # small blocks prevent the pool from shrinking
del kept[::2]
print(resident() - before)
"""


def test_freed_memory_is_returned():
    returned, remaining = (
        float(python(_RESIDENT + program, check=True).stdout) for program in (_PIECES, _BLOCKS)
    )
    assert returned > 50  # MB of 100
    assert remaining < 20

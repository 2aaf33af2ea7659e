"""What is compiled while the user looks at the first picture."""

import subprocess
import sys

_SAY = """
from abfm_viewer.window import warm_up
warm_up.start().join()
from abfm.flow import series_kernels
from abfm.mesh import edge_collapse
from abfm.numerics import optimizer
from abfm.streaks import streamlines, texels
for module in (series_kernels, edge_collapse, optimizer, streamlines, texels):
    kernels = [value for value in vars(module).values() if getattr(value, "__module__", "") == module.__name__]
    print(module.__name__, sum(bool(getattr(value, "signatures", ())) for value in kernels))
"""


def test_the_first_match_finds_its_kernels_compiled():
    """In a process of its own, in which nothing else has compiled them."""
    done = subprocess.run([sys.executable, "-c", _SAY], capture_output=True, text=True, check=True)
    compiled = {name: int(count) for name, count in map(str.split, done.stdout.splitlines())}
    assert len(compiled) == 5
    assert min(compiled.values()) > 0, compiled

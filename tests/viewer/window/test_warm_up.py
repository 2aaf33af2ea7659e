"""What is compiled while the user looks at the first picture."""

from tests.processes import python

_SAY = """
from abfm_viewer.window import warm_up
warm_up.start().join()
from abfm.flow import exponential
from abfm.mesh import coarsening
from abfm.numerics import optimizer
from abfm.streaks import line_integral
import sys  # the room has a function of this name
texture_atlas = sys.modules["abfm.streaks.texture_atlas"]
for module in (exponential, coarsening, optimizer, line_integral, texture_atlas):
    own = [v for v in vars(module).values() if getattr(v, "__module__", "") == module.__name__]
    print(module.__name__, sum(bool(getattr(value, "signatures", ())) for value in own))
"""


def test_the_first_match_finds_its_kernels_compiled():
    """In a process of its own, in which nothing else has compiled them."""
    done = python(_SAY, check=True)
    compiled = {name: int(count) for name, count in map(str.split, done.stdout.splitlines())}
    assert len(compiled) == 5
    assert min(compiled.values()) > 0, compiled

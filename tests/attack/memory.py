"""Memory that runs out at some moment of a match: one line, or the best field so far, no crash.

The command runs twice in its process, which may then have some megabytes more than the first time.
"""

import os
import random
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from abfm.assets import asset_path
from tests.attack.trial import Trial, run
from tests.processes import python

MESHES = ("human_A.off", "eight.off", "human_fine_A.off")
COURSES = ((), ("--method=linearised", "--segments=5"), ("--gradient=bracket",), ("--levels=2",))
_PAIR = (
    "--source=gaussian:vertex=7,width=0.1",
    "--target=gaussian:vertex=40,width=0.1",
    "--iterations=15",
)
_PATIENCE = 300  # seconds
_MOST = 1500  # megabytes: more than a match of these meshes takes

_CHILD = """
import contextlib, io, resource, sys
from abfm_viewer.cli import main
words = sys.argv[2:]
# all is loaded once
with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
    main([*words, "--iterations", "1"])
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, 2 * (size + int(float(sys.argv[1]) * 2**20),))
sys.exit(main(words))
"""


def attempt(seed):
    """A match with a random limit."""
    rng = random.Random(seed)
    mesh, course = rng.choice(MESHES), rng.choice(COURSES)
    megabytes = _MOST ** rng.random()
    with TemporaryDirectory() as folder:
        out = Path(folder) / "m.npz"
        words = ["match", asset_path(mesh), *_PAIR, "--out", out, *course]
        alone = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        child = python(_CHILD, megabytes, *words, timeout=_PATIENCE, env=alone)
        wrong = fault(child.returncode, child.stderr, out)
        left = [path.name for path in Path(folder).iterdir() if path != out]
    wrong = wrong or (f"left {left[0]}" if left else "")
    outcome = "fault" if wrong else "refused" if child.returncode == 2 else "ok"
    return Trial(f"{mesh}/{' '.join(course) or 'default'}/{megabytes:.0f} MB", seed, outcome, wrong)


def fault(code, errors, out):
    """What is wrong with how a command ended; empty if nothing is."""
    last = (errors.strip().splitlines() or [""])[-1]
    if code not in (0, 2, 3):
        return f"exit {code}: {last[:200]}"
    if "Traceback" in errors:
        return f"traceback: {last[:200]}"
    if code == 2:
        return "" if len(last) > 10 else "no word of why"
    with np.load(out) as result:
        return "" if np.isfinite(result["velocity"]).all() else "a field that is not finite"


if __name__ == "__main__":
    run(attempt, __doc__)

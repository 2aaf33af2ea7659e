"""An attacker whose victims do what none should, so that tests see that it is told."""

from __future__ import annotations

from tests.attack import doors
from tests.attack.specimens import Specimen

ACTS = {
    "raise KeyError('x')": "KeyError: 'x' (outside of abfm)",
    "from abfm import AbfmError; e = AbfmError(); e.args = ('two\\nlines',); raise "
    "e": "an error of 2 lines",
    "from abfm import AbfmError; raise AbfmError('None' 'Type object')": "in the words of Python",
    "import os; os.abort()": "the process died: SIGABRT",
    "import os; os.write(2, b'oh')": "it said: 'oh'",
    "import warnings; warnings.warn('beware')": "it said: 'UserWarning: beware'",
    "len(b'x' * 200 * 10**6)": " MB of memory",
    "while True: pass": "more than 1 s of CPU time",
}
"""What is done, and what is to be told of it."""


def decoy(seed: int) -> tuple[Specimen, str]:
    """The act of a number."""
    doors.DOORS["spec"] = lambda path: exec(path.read_text())
    return Specimen("a.spec", "spec", list(ACTS)[seed].encode()), "decoy"

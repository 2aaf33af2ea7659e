"""How the program ends: with its status, when all have tidied up, and without taking the
interpreter apart.
"""

from __future__ import annotations

import subprocess

from tests.processes import python

_PROGRAM = """
import atexit, sys
from abfm_viewer import app
class Slow:
    def __del__(self):
        print("taken apart")
def run(words):
    atexit.register(lambda: print("tidied up"))
    print("closed", words)
    return 7
app._run = run
kept = sys.modules["kept"] = Slow()
sys.argv[1:] = ["a.off"]
status = app.main({words})
sys.exit(status)
"""


def ended(words: str) -> subprocess.CompletedProcess[str]:
    program = _PROGRAM.replace("{words}", words)
    return python(program, timeout=60)


def test_the_program_ends_when_all_have_tidied_up():
    done = ended("")
    assert (done.returncode, done.stderr) == (7, "")
    assert done.stdout.splitlines() == ["closed ['a.off']", "tidied up"]


def test_who_calls_it_with_words_lives_on():
    done = ended("['b.off']")
    assert (done.returncode, done.stderr) == (7, "")
    assert done.stdout.splitlines() == ["closed ['b.off']", "tidied up", "taken apart"]

"""Valid files made wrong at random, opened through the users' doors."""

from __future__ import annotations

from tests.attack.trial import run
from tests.attack.victim import ROOT, Victim

if __name__ == "__main__":
    with Victim("mutations", "tests.attack.mutant:mutant", ROOT / "out" / "attack") as victim:
        run(victim.attempt, __doc__)

"""Files, and what is none, made to hurt who opens them."""

from __future__ import annotations

from random import Random

from tests.attack import hostile_arrays, hostile_meshes, hostile_places
from tests.attack.specimens import Specimen
from tests.attack.trial import run
from tests.attack.victim import ROOT, Victim

_MAKERS = (*hostile_meshes.MAKERS, *hostile_arrays.MAKERS, *hostile_places.MAKERS)


def hostile(seed: int) -> tuple[Specimen, str]:
    """What the seed puts in the way, and what it is called; seeds one after the other take all
    kinds in turn.
    """
    maker = _MAKERS[seed % len(_MAKERS)]
    specimen = maker(Random(seed))
    return specimen, f"{maker.__name__} as {specimen.name}"


if __name__ == "__main__":
    with Victim("hostile", "tests.attack.hostile:hostile", ROOT / "out" / "attack") as victim:
        run(victim.attempt, __doc__)

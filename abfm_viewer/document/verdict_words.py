"""What a match came to, in the words of window, pictures and command line."""

from __future__ import annotations

import math

import abfm
from abfm.wording import counted, sentence, share


def residual_text(now: abfm.matching.Iteration, is_of_landmarks: bool) -> str:
    """``residual 0.31``, or of landmarks alone ``farthest landmark 3.1% away``."""
    if not is_of_landmarks:
        return f"residual {now.residual:.3g}"
    from abfm.matching.terms.landmarks import error_of

    return f"farthest landmark {share(error_of(now.residual))} away"


def was_interrupted(match: abfm.Match) -> bool:
    return match.stop_reason in ("cancelled", "out of memory")


def changes(remedy: abfm.matching.Remedy) -> str:
    """Say what a remedy does, for a tooltip: ``A larger reach: reach 1, from no motion``."""
    changed = ", ".join(
        f"{name} {abfm.matching.value_text(value)}" for name, value in remedy.parameters.items()
    )
    start = "from the present field" if remedy.goes_on else "from no motion"
    given = f", with {changed}" if changed else ""
    return f"{sentence(remedy.words)}\nStarts a run {start}{given}."


def numbers_text(match: abfm.Match) -> str:
    """``Residual 0.012, 0.03 by flow lines``; of landmarks alone, which a list has, what folds."""
    if not match.problem.is_of_landmarks:
        return f"Residual {abfm.matching.residual_text(match)}"
    return "" if math.isnan(match.folded) else f"{100 * match.folded:.2g}% folded"


def refinement(match: abfm.Match) -> str:
    """``found on the mesh subdivided 2 times, 16 times the faces``; empty for the mesh itself."""
    times = counted(match.refined, "time")
    found = f"found on the mesh subdivided {times}, {4**match.refined} times the faces"
    return found if match.refined else ""


def place(now: abfm.matching.Iteration) -> str:
    """Say where in its course a match is: ``mesh 1/3, stage 2, reach 0.5``."""
    mesh = f"mesh {now.level + 1}/{now.levels}, " if now.levels > 1 else ""
    return f"{mesh}stage {now.stage + 1}{f', reach {now.reach:g}' if now.reach else ''}"

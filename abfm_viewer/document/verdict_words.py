"""Short texts about a match, for the window, pictures and the command line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import chain

import abfm
from abfm.outcome import worse_residual
from abfm.wording import sentence, share

LONG_RANGE = "long-range search"  # the stages with a positive reach
SOLVING_PHASES = ("match", "refine")  # phases whose iterations are reported


def residual_text(now: abfm.matching.Iteration) -> str:
    """Return the residual of an iterate: ``residual 31%``.

    If only landmarks are matched, return their largest error: ``farthest landmark 3.1% away``.
    """
    if not now.is_of_landmarks:
        return f"residual {share(now.residual)}"
    from abfm.matching.terms.landmarks import error_of

    return f"farthest landmark {share(error_of(now.residual))} away"


def remedy_tooltip(remedy: abfm.matching.Remedy) -> str:
    changed = ", ".join(
        f"{name} {abfm.matching.value_text(value)}" for name, value in remedy.parameters.items()
    )
    start = "from the current field" if remedy.starts_from_field else "from a zero field"
    given = f", with {changed}" if changed else ""
    return f"{sentence(remedy.words)}\nStarts a run {start}{given}."


def numbers_text(match: abfm.Match) -> str:
    """Return both residuals of a match: ``Residual 1.2%, 3% along flow lines``.

    The number of consecutive fields is left out, so that the text fits into one line. If only
    landmarks were matched, return the share of folded faces, or an empty text if it is unknown.
    """
    if not match.problem.is_of_landmarks:
        parts = abfm.matching.residual_text(match).split(", ")
        return f"Residual {', '.join(part for part in parts if 'fields' not in part)}"
    return "" if math.isnan(match.folded) else f"{100 * match.folded:.2g}% folded"


def refinement_text(match: abfm.Match) -> str:
    """Return ``found on a finer mesh, with 16 times as many faces``; empty without a finer mesh."""
    found = f"found on a finer mesh, with {4**match.refined} times as many faces"
    return found if match.refined else ""


def best_text(
    now: abfm.matching.Iteration, others: Iterable[Sequence[abfm.matching.PathStep]]
) -> str:
    """Return ``, best step 14%``, by both checks; empty if the present residual is smaller.

    ``others`` are the steps of other attempts.
    """
    steps = chain(now.path, *others)
    worse = (worse_residual(step.residual, step.verified_residual) for step in steps)
    best = min(worse, default=math.inf)
    return f", best step {share(best)}" if best < now.residual and not now.is_of_landmarks else ""


def attempt_text(now: abfm.matching.Iteration) -> str:
    """Return ``attempt 1 of 2`` during the search of a match, if it may have several attempts."""
    is_search = now.attempts > 1 and now.level == 0
    return f"attempt {now.attempt} of {now.attempts}" if is_search else ""


def stage_text(now: abfm.matching.Iteration) -> str:
    """Return the stage of an iterate: ``mesh of 638 vertices, σ 18, long-range search``."""
    search = f", {LONG_RANGE}" if now.reach else ""
    return f"mesh of {now.vertices:,} vertices, σ {now.sigma:.3g}{search}"

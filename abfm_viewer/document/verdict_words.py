"""Short texts about a match, for the window, pictures and the command line."""

from __future__ import annotations

import math

import abfm
from abfm.outcome import Facts
from abfm.wording import sentence, share

_ABBREVIATIONS = {
    "less than ": "<",
    "areas change by a factor of ": "areas ×",
    "distortion within ": "distortion ≤",
}


def short_headline(facts: Facts) -> str:
    """Return the headline of facts, abbreviated: ``matched (residual 4.3%), areas ×1.4``."""
    headline = facts.headline
    for phrase, shorter in _ABBREVIATIONS.items():
        headline = headline.replace(phrase, shorter)
    return headline


def residual_text(now: abfm.matching.Iteration, is_of_landmarks: bool) -> str:
    """Return the residual of an iterate: ``residual 0.31``.

    If only landmarks are matched, return their largest error: ``farthest landmark 3.1% away``.
    """
    if not is_of_landmarks:
        return f"residual {now.residual:.3g}"
    from abfm.matching.terms.landmarks import error_of

    return f"farthest landmark {share(error_of(now.residual))} away"


def was_interrupted(match: abfm.Match) -> bool:
    return match.stop_reason in ("cancelled", "out of memory")


def remedy_tooltip(remedy: abfm.matching.Remedy) -> str:
    changed = ", ".join(
        f"{name} {abfm.matching.value_text(value)}" for name, value in remedy.parameters.items()
    )
    start = "from the current field" if remedy.starts_from_field else "from a zero field"
    given = f", with {changed}" if changed else ""
    return f"{sentence(remedy.words)}\nStarts a run {start}{given}."


def numbers_text(match: abfm.Match) -> str:
    """Return both residuals of a match: ``Residual 0.012, 0.03 along flow lines``.

    If only landmarks were matched, return the share of folded faces, or an empty text if it is
    unknown.
    """
    if not match.problem.is_of_landmarks:
        return f"Residual {abfm.matching.residual_text(match)}"
    return "" if math.isnan(match.folded) else f"{100 * match.folded:.2g}% folded"


def refinement_text(match: abfm.Match) -> str:
    """Return ``found on a finer mesh, with 16 times as many faces``; empty without a finer mesh."""
    found = f"found on a finer mesh, with {4**match.refined} times as many faces"
    return found if match.refined else ""


def stage_text(now: abfm.matching.Iteration) -> str:
    """Return an iterate's mesh, stage, and reach (distance over which functions are compared)."""
    mesh = f"mesh {now.level + 1}/{now.levels}, " if now.levels > 1 else ""
    return f"{mesh}stage {now.stage + 1}{f', reach {now.reach:g}' if now.reach else ''}"

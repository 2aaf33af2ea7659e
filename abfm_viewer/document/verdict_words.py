"""What a match came to, in the words of window and command line."""

from __future__ import annotations

import math

import abfm

_OTHERWISE = {  # of matches that did not come to their end
    "cancelled": "The best field so far was kept.",
    "given": "Nothing was solved: press Play below the surfaces to see its flow. Match looks for a field of its own.",
}


def headline(match: abfm.Match) -> str:
    """How it ended, in a line: ``matched: mismatch 0.012, 0.03 by flow lines, 0.1% folded``."""
    ends = {"cancelled": "cancelled", "given": "field given"}
    return f"{ends.get(match.stop_reason, match.verdict.kind)}: mismatch {numbers(match)}"


def explanation(match: abfm.Match) -> list[str]:
    """Why it ended so, and what to try, each a sentence."""
    if match.stop_reason in _OTHERWISE:
        return [_OTHERWISE[match.stop_reason]]
    verdict = match.verdict
    tried = [f"To try: {verdict.advice}."] if verdict.advice else []
    return [f"{verdict.reason[:1].upper()}{verdict.reason[1:]}.", *tried]


def numbers(match: abfm.Match) -> str:
    """The mismatch, and what is known of its verification: ``0.012, 0.03 by flow lines, 0.1% folded``."""
    parts = [f"{match.mismatch:.3g}"]
    if not math.isnan(match.verified_mismatch):
        parts.append(f"{match.verified_mismatch:.3g} by flow lines")
    if not math.isnan(match.folded):
        parts.append(f"{100 * match.folded:.2g}% folded")
    return ", ".join(parts)


def place(now: abfm.Iteration) -> str:
    """Where in its course a match is: ``mesh 1/3, stage 2, reach 0.5``."""
    parts = [f"mesh {now.level + 1}/{now.levels}"] if now.levels > 1 else []
    parts.append(f"stage {now.stage + 1}")
    if now.reach:
        parts.append(f"reach {now.reach:g}")
    return ", ".join(parts)

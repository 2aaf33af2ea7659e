"""Reports of a match and its path, as values for programs and as lines of text."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from abfm.matching.judging.facts import finite
from abfm.matching.judging.verdict import Verdict
from abfm.matching.path import NUMBERS, PathStep
from abfm.matching.result import Match
from abfm.mesh.subdivision import times_subdivided
from abfm.outcome import Facts
from abfm.parameters import as_option, in_options
from abfm.wording import counted, number_text, percents, share

STEP_COLUMNS = ("step", "sigma", "residual", "flow lines", "folded", "|log2 J|", "|log2 R|")
SCORE = "score"  # column of paths of measured functions


def details(
    match: Match, facts: Facts | None = None, verdict: Verdict | None = None
) -> dict[str, Any]:
    """Return the report of a match as plain numbers and texts; None for unknown values.

    ``facts`` and ``verdict`` of a registration may replace those of the match.
    """
    facts, energies = facts or match.facts, match.energy_history[-1].tolist()
    return {
        **facts.numbers,
        "headline": facts.headline,
        "warnings": list(facts.warnings),
        "verdict": asdict(verdict or match.verdict),
        "energy": dict(zip(("total", "regularity", "mismatch"), energies, strict=True)),
        "iterations": len(match.energy_history) - 1,
        "stop_reason": match.stop_reason,
        "vertices": len(match.mesh.vertices),
        "faces": len(match.mesh.faces),
        "refined": match.refined,
        "fields": len(match.fine_velocity),
        "path": [_row(match, each) for each in match.path],
        "step": match.step,
        "messages": list(match.mesh.messages),
        "parameters": match.parameters.to_dict(),
    }


def lines(match: Match, facts: Facts | None = None) -> list[str]:
    """Return the report of a match as lines of text.

    ``facts`` may be those of a registration.
    """
    facts, iterations = facts or match.facts, len(match.energy_history) - 1
    return [
        *facts.lines,
        f"residual {residual_text(match)}, after {counted(iterations, 'iteration')}",
        *(path_lines(match) if len(match.path) > 1 else []),
    ]


def residual_text(match: Match) -> str:
    """Return the residuals of a match: ``1.2%, 3% along flow lines, 0.1% folded``.

    If the match has several consecutive fields, the text ends with their number.
    """
    parts = [share(match.residual)]
    if not math.isnan(match.verified_residual):
        parts.append(f"{share(match.verified_residual)} along flow lines")
    if not math.isnan(match.folded):
        parts.append(f"{100 * match.folded:.2g}% folded")
    if len(match.fine_velocity) > 1:
        parts.append(f"{len(match.fine_velocity)} consecutive fields")
    return ", ".join(parts)


def value_text(value: object) -> str:
    """Return the value of a parameter as text; ``auto`` for None."""
    return f"{value:g}" if isinstance(value, float) else "auto" if value is None else str(value)


def advice_in_options(verdict: Verdict, facts: Facts, result: str = "") -> str:
    """Return the advice as command-line options: ``refine (--refine 1 --start match.npz)``.

    Advice that changes no parameter is returned in words, with names of options. The file
    ``result`` is the start of the next run; without it, the options start without motion.
    """
    found = []
    for remedy in verdict.remedies:
        if not (result or remedy.parameters):
            continue
        words = [as_option(name, value) for name, value in remedy.parameters.items()]
        words += [f"--start {result}"] if remedy.starts_from_field and result else []
        found.append(f"{remedy.label.lower()} ({' '.join(words)})")
    return ", or ".join(found) or in_options(facts.advice)


def _row(match: Match, step: PathStep) -> dict[str, float | None]:
    numbers = {name: finite(getattr(step, name)) for name in NUMBERS}
    return {**numbers, "refined": times_subdivided(step.velocity.shape[1], match.mesh)}


def path_lines(match: Match) -> list[str]:
    """Return the path as lines of a table; a star marks the selected step."""
    steps = [_row(match, step) for step in match.path]
    has_scores = any(step[SCORE] is not None for step in steps)
    heads = [*STEP_COLUMNS, "refined", *([SCORE] if has_scores else [])]
    rows = [heads]
    for number, step in enumerate(steps, 1):
        residuals = [number_text(step[name], ".3g") for name in ("residual", "verified_residual")]
        distortion = [number_text(step[name], ".3g") for name in ("log2_area", "log2_shape")]
        folded, sigma = percents(step["folded"]), number_text(step["sigma"], ".3g")
        cells = [str(number), sigma, *residuals, folded, *distortion, str(step["refined"])]
        rows.append([*cells, number_text(step[SCORE], ".4f")][: len(heads)])
    pairs = [zip(row, heads, strict=True) for row in rows]
    lines = ["".join(f"{cell:>{len(head) + 3}}" for cell, head in each) for each in pairs]
    lines[match.step + 1] = lines[match.step + 1].replace(" ", "*", 1)
    return lines

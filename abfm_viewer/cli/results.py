"""Facts of a match, of its path and of its distortion, for people and for machines."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from abfm import Correspondence, Match, PathStep, Registration
from abfm.errors import printable
from abfm.maps import Distortion
from abfm.matching.judging.facts import finite
from abfm.matching.path import NUMBERS
from abfm.mesh.subdivision import times_subdivided
from abfm.wording import number_text, percents
from abfm_viewer.document import verdict_words

STEP_HEADS = ("step", "sigma", "residual", "by flow lines", "folded", "|log2 J|", "|log2 R|")
SCORE = "score"  # of steps of measured functions


def facts(found: Match | Registration) -> dict[str, Any]:
    """Return the facts of a match, or of a registration, for machines: plain numbers and texts,
    None for unknown ones.
    """
    match = found.match if isinstance(found, Registration) else found
    energies = match.energy_history[-1].tolist()
    return {
        **found.facts.numbers,
        "headline": found.facts.headline,
        "warnings": list(found.facts.warnings),
        "verdict": asdict(found.verdict),
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


def told_lines(found: Match | Registration, seconds: float, written: Sequence[str]) -> list[str]:
    """Return how well it matches, why it stopped, the numbers, and the path, for people."""
    match = found.match if isinstance(found, Registration) else found
    return [
        found.facts.headline,
        found.facts.reason,
        *(f"warning: {warning}" for warning in found.facts.warnings),
        f"residual {verdict_words.numbers(match)}, after {len(match.energy_history) - 1} "
        f"iterations in {seconds:.1f} s; wrote {', '.join(written)}",
        *(path_lines(match) if len(match.path) > 1 else []),
    ]


def print_notes(notes: Sequence[str]) -> None:
    """Print notes to stderr, a line each."""
    for note in notes:
        print(f"note: {printable(note)}", file=sys.stderr)


def _row(match: Match, step: PathStep) -> dict[str, float | None]:
    numbers = {name: finite(getattr(step, name)) for name in NUMBERS}
    return {**numbers, "refined": times_subdivided(step.velocity.shape[1], match.mesh)}


def path_lines(match: Match) -> list[str]:
    """Return the path as a table of a line a step, a star before the one that the match is."""
    steps = [_row(match, step) for step in match.path]
    heads = [*STEP_HEADS, "refined", *([SCORE] if has_scores(steps) else [])]
    rows = [heads]
    for number, step in enumerate(steps):
        cells = [*step_cells(number, step, ".3g"), str(step["refined"])]
        rows.append([*cells, number_text(step[SCORE], ".4f")][: len(heads)])
    pairs = [zip(row, heads, strict=True) for row in rows]
    lines = ["".join(f"{cell:>{len(head) + 3}}" for cell, head in each) for each in pairs]
    lines[match.step + 1] = lines[match.step + 1].replace(" ", "*", 1)
    return lines


def has_scores(steps: Iterable[Mapping[str, float | None]]) -> bool:
    return any(step[SCORE] is not None for step in steps)


def step_cells(number: int, step: Mapping[str, Any], digits: str) -> list[str]:
    """Return the texts below `STEP_HEADS` of a step of a path, by its facts."""
    left = [number_text(step[name], digits) for name in ("residual", "verified_residual")]
    cost = [number_text(step[name], digits) for name in ("log2_area", "log2_shape")]
    return [str(number + 1), f"{step['sigma']:.3g}", *left, percents(step["folded"]), *cost]


def map_facts(found: Correspondence, distortion: Distortion | None = None) -> dict[str, Any]:
    """Return the facts of a map from B to A for machines; its distortion may be known
    already.
    """
    distortion, back = distortion or found.distortion(), found.there_and_back()
    return {
        **distortion_facts(distortion),
        "collapsed": distortion.collapsed,
        "coverage": found.coverage(),
        "there_and_back": back._asdict(),
    }


def distortion_facts(distortion: Distortion) -> dict[str, Any]:
    return {
        "log2_area": distortion.log2_area._asdict(),
        "log2_shape": distortion.log2_shape._asdict(),
        "folded": distortion.folded,
        "faces": len(distortion.flipped),
    }


def initial_facts(initial: Correspondence) -> dict[str, Any]:
    """Return which initial map was chosen, and the cost of each one that was tried."""
    tried = initial.candidates
    return {
        "initial": tried[0].name if tried else "given",
        "initial_candidates": [{"name": each.name, "cost": finite(each.cost)} for each in tried],
    }


def map_lines(found: Correspondence) -> list[str]:
    """Return the same in lines for people."""
    return [
        found.distortion().report(),
        f"{found.there_and_back().report()}; {100 * found.coverage():.1f}% of A is covered",
    ]


def landmark_lines(found: Registration) -> list[str]:
    """Return how far landmarks are left, in a line, where there are any."""
    errors = found.landmark_errors
    if errors is None:
        return []
    if len(errors) == 1:
        return [f"the landmark is left off by {errors[0]:.2g} sqrt(area)"]
    numbers = f"mean {errors.mean():.2g}, largest {errors.max():.2g} sqrt(area)"
    return [f"{len(errors)} landmarks are left off by {numbers}"]

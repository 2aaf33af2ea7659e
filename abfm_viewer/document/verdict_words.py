"""What a match came to, in the words of window, pictures and command line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import abfm

if TYPE_CHECKING:
    from abfm.matching import Remedy

Tone = Literal["good", "ink", "failure"]
"""The colour that means it, of the theme's."""

_OTHERWISE = {  # of matches that did not come to their end
    "cancelled": "it was cancelled, and the best field so far was kept",
    "out of memory": "memory ran out, and the best field so far was kept",
    "given": "nothing was solved: Play shows its flow, Match looks for a field of its own",
}
_ENDED = {  # of those that are matched, or nearly, without another cause
    "converged": "no change of the field gains anything more",
    "goal reached": "the mismatch came well below the goal",
    "no progress": "it stopped where going on gained little",
    "line search failed": "no step lowers the energy any more, which is often rounding",
    "iteration limit": "it stopped after the {iterations} iterations it was given",
}
_LEAST = 1e-4  # a smaller mismatch is told as less than this
_MOST_LOG2 = 100.0  # of areas, by which they change: beyond, and if unknown, nothing is told
_ALL = 0.995  # a share that reads as 100%


def capital(text: str) -> str:
    """A text with a capital first letter, and the rest as it is: names of files keep theirs."""
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    return f"{capital(text)}."


def counted(number: int, noun: str) -> str:
    """``1 iteration``, ``2 iterations``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def share(value: float) -> str:
    """A share in percent, with as many digits as one reads: ``0.7%``, ``2.6%``, ``33%``.

    Rounded up: what is beyond a bound of so few digits never reads as within it, nor the other way
    round.
    """
    if value < _LEAST:
        return f"less than {100 * _LEAST:g}%"
    digit = 0.01 if value >= 0.1 else 0.001 if value >= 0.001 else 0.0001
    return f"{100 * digit * math.ceil(round(value / digit, 6)):.6g}%"


def headline(match: abfm.Match) -> str:
    """Return how well it matches: ``matched to 0.7%``, ``nearly: 8% left``,
    ``registered: 42% left, areas change by 16%``, ``not reached: 33% left``, ``impossible``.

    The share is what the worse of the two witnesses leaves (`Match.confirmed_mismatch`): a smaller
    one never has a worse word by size. Where the word has another cause, such as folds, there is
    none; `why` has the cause. Of landmarks alone it is how far they are left at most.
    """
    if match.stop_reason == "given":
        return "field given"
    if match.problem.is_of_landmarks:
        word = match.stop_reason if is_broken_off(match) else match.verdict.kind
        return f"{word}: {_landmarks(match)}"
    kind, confirmed = match.verdict.kind, match.confirmed_mismatch
    told = abfm.matching.kind_of(confirmed, match.parameters.goal)
    left = f"{share(confirmed)} left"
    if told == "not reached":
        if confirmed >= _ALL * match.initial_mismatch:
            left = "nothing gained"
        elif confirmed >= _ALL:
            left = "little gained"
    if match.stop_reason == "cancelled":
        return f"cancelled: {left}"
    if kind == "registered":
        cost = match.path[match.step].log2_area
        areas = f", areas change by {share(2**cost - 1)}" if cost < _MOST_LOG2 else ""
        return f"registered: {left}{areas}"
    if kind != told:
        return kind
    return f"matched to {share(confirmed)}" if kind == "matched" else f"{kind}: {left}"


def of_interval(sequence: abfm.Sequence, interval: int) -> str:
    """Return what an interval of a film came to, as `headline` does: ``matched to 0.7%``; a word
    that has another cause than the size of what is left comes without a share.
    """
    from abfm.matching.judging.verdict import confirmed_mismatch

    kind = sequence.verdicts[interval].kind
    witnesses = sequence.mismatch[interval], sequence.verified_mismatch[interval]
    left = confirmed_mismatch(*map(float, witnesses))
    if kind == "registered":
        return f"{kind}: {share(left)} left"
    if kind != abfm.matching.kind_of(left, sequence.parameters.goal) or kind == "not reached":
        return kind
    return f"matched to {share(left)}" if kind == "matched" else f"{kind}: {share(left)} left"


def _landmarks(match: abfm.Match) -> str:
    """``5 landmarks within 0.31% of sqrt(area)``."""
    errors = match.landmark_errors
    assert errors is not None
    farthest = float(errors.max())
    if not math.isfinite(farthest):
        return f"where the flow takes {counted(len(errors), 'landmark')} is unknown"
    return f"{counted(len(errors), 'landmark')} within {share(farthest)} of sqrt(area)"


def left_now(now: abfm.Iteration, is_of_landmarks: bool) -> str:
    """``mismatch 0.31``, or of landmarks alone ``farthest landmark 3.1% away``."""
    if not is_of_landmarks:
        return f"mismatch {now.mismatch:.3g}"
    from abfm.matching.terms.landmarks import error_of

    return f"farthest landmark {share(error_of(now.mismatch))} away"


def tone(match: abfm.Match) -> Tone:
    if match.stop_reason in _OTHERWISE or match.verdict.kind == "nearly":
        return "ink"
    return "good" if match.verdict.kind in ("matched", "registered") else "failure"


def is_broken_off(match: abfm.Match) -> bool:
    return match.stop_reason in ("cancelled", "out of memory")


def why(match: abfm.Match) -> str:
    if match.stop_reason in _OTHERWISE:
        return _OTHERWISE[match.stop_reason]
    ended = _ENDED.get(match.stop_reason, match.stop_reason)
    told = match.verdict.cause or ended.format(iterations=match.parameters.iterations)
    if match.verdict.kind == "registered":
        return f"{told}; at first {share(match.initial_mismatch)} was left"
    if match.verdict.kind == "matched" and match.problem.is_of_landmarks:
        return "flow lines bring every landmark to where it belongs"
    is_known = not math.isnan(match.verified_mismatch)
    if match.verdict.kind == "matched" and is_known and not match.verdict.cause:
        return f"the discrete flow and flow lines both leave at most {share(match.parameters.goal)}"
    return told


def advice(match: abfm.Match) -> str:
    return "" if match.stop_reason == "given" else match.verdict.advice


def advice_in_options(match: abfm.Match, result: str = "") -> str:
    """Say what to try: ``reach further (--reach 0.6 --start match.npz)``, or in words; without a
    result to start from all begins with no motion.
    """
    found = []
    for remedy in match.verdict.remedies:
        if not (result or remedy.parameters):
            continue
        given = remedy.parameters.items()
        words = [f"--{name.replace('_', '-')} {_plain(value)}" for name, value in given]
        words += [f"--start {result}"] if remedy.goes_on and result else []
        found.append(f"{remedy.label.lower()} ({' '.join(words)})")
    return ", or ".join(found) or advice(match)


def changes(remedy: Remedy) -> str:
    """Say what a remedy does, for a tooltip: ``A larger reach: reach 1, from no motion``."""
    changed = ", ".join(f"{name} {_plain(value)}" for name, value in remedy.parameters.items())
    start = "from the present field" if remedy.goes_on else "from no motion"
    given = f", with {changed}" if changed else ""
    return f"{sentence(remedy.words)}\nStarts a run {start}{given}."


def _plain(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else "auto" if value is None else str(value)


def in_numbers(match: abfm.Match) -> str:
    """``Mismatch 0.012, 0.03 by flow lines``; of landmarks alone, which a list has, what folds."""
    if not match.problem.is_of_landmarks:
        return f"Mismatch {numbers(match)}"
    return "" if math.isnan(match.folded) else f"{100 * match.folded:.2g}% folded"


def numbers(match: abfm.Match) -> str:
    """Write the mismatch and its verification: ``0.012, 0.03 by flow lines, 0.1% folded``; and how
    many fields in a row it took, if more than one.
    """
    parts = [f"{match.mismatch:.3g}"]
    if not math.isnan(match.verified_mismatch):
        parts.append(f"{match.verified_mismatch:.3g} by flow lines")
    if not math.isnan(match.folded):
        parts.append(f"{100 * match.folded:.2g}% folded")
    if len(match.fine_velocity) > 1:
        parts.append(f"{len(match.fine_velocity)} fields in a row")
    return ", ".join(parts)


def refinement(match: abfm.Match) -> str:
    """``found on the mesh subdivided 2 times, 16 times the faces``; empty for the mesh itself."""
    times = counted(match.refined, "time")
    found = f"found on the mesh subdivided {times}, {4**match.refined} times the faces"
    return found if match.refined else ""


def place(now: abfm.Iteration) -> str:
    """Say where in its course a match is: ``mesh 1/3, stage 2, reach 0.5``."""
    mesh = f"mesh {now.level + 1}/{now.levels}, " if now.levels > 1 else ""
    return f"{mesh}stage {now.stage + 1}{f', reach {now.reach:g}' if now.reach else ''}"

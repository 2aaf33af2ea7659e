"""Running a match from the command line: progress, Ctrl-C, output files and what is said at the
end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import abfm
from abfm import Control, Match, Problem
from abfm.errors import printable
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UNMATCHED
from abfm_viewer.cli.interrupt import cancelled_by_signals
from abfm_viewer.cli.progress import progress
from abfm_viewer.document import verdict_words
from abfm_viewer.files import outputs


@dataclass(frozen=True)
class Outcome:
    """A match that was computed and written."""

    match: Match
    seconds: float
    outputs: Sequence[Path]
    signal: int | None  # that came, also after the last iteration

    @property
    def status(self) -> int:
        """Exit status: 130 or the like when a signal came; 3 when the target was not reached."""
        if self.signal is not None:
            return signals.status(self.signal)
        return 0 if self.match.verdict.kind in ("matched", "nearly") else UNMATCHED

    def summary(self) -> str:
        """Say for a person how well it matches, why it stopped, the numbers, and what to try if
        there is anything.
        """
        match = self.match
        lines = [
            verdict_words.headline(match),
            verdict_words.why(match),
            f"mismatch {verdict_words.numbers(match)}, after {len(match.energy_history) - 1} "
            f"iterations in {self.seconds:.1f} s; wrote {', '.join(map(printable, self.outputs))}",
        ]
        result = next(
            (printable(path) for path in self.outputs if path.suffix == ".npz"), "RESULT.npz"
        )
        if advice := verdict_words.advice_in_options(match, result):
            lines.append(f"to try: {advice}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the same and more for a program."""
        match = self.match
        return {
            "mismatch": float(match.mismatch),
            "verified_mismatch": _known(match.verified_mismatch),
            "folded": _known(match.folded),
            "verdict": asdict(match.verdict),
            "energy": dict(
                zip(
                    ("total", "regularity", "mismatch"),
                    match.energy_history[-1].tolist(),
                    strict=True,
                )
            ),
            "iterations": len(match.energy_history) - 1,
            "stop_reason": match.stop_reason,
            "seconds": self.seconds,
            "vertices": len(match.mesh.vertices),
            "faces": len(match.mesh.faces),
            "messages": list(match.mesh.messages),
            "parameters": match.parameters.to_dict(),
            "outputs": list(map(str, self.outputs)),
        }


def _known(value: float) -> float | None:
    """Return a number for JSON, which has no NaN."""
    return None if math.isnan(value) else float(value)


def solve(problem: Problem, outs: Sequence[Path], quiet: bool) -> Outcome:
    """Match with progress on stderr and write the result, also after a signal."""
    control = Control()
    start = time.perf_counter()
    with cancelled_by_signals(control) as kept:
        with progress(problem.parameters.iterations, quiet) as report:
            match = abfm.match(problem, on_iteration=report, control=control)
        seconds = time.perf_counter() - start
        outputs.write_all(outs, match)
    return Outcome(match, seconds, outs, kept.number)

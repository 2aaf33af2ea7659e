"""Running a match from the command line: signals, progress, files, and what is said at the end."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import abfm
from abfm import Control, Match, Problem
from abfm.errors import printable
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UNMATCHED
from abfm_viewer.cli.progress import progress
from abfm_viewer.document import verdict_words
from abfm_viewer.files import outputs

_TOGETHER = 0.1  # seconds: `timeout` and terminals may send a signal to a process and to its group


@dataclass
class Kept:
    """The signal that came, if any."""

    number: int | None = None


@contextmanager
def cancelled_by_signals(
    control: Control, what: str = "with the best result so far"
) -> Iterator[Kept]:
    """Cancel at the first signal, and say with what; leave at a second one, if it comes later."""
    kept, came = Kept(), 0.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if kept.number is None:
            kept.number, came = number, time.monotonic()
            control.cancel()
            with suppress(OSError):  # not print, which may just have been interrupted
                os.write(2, f"stopping {what}; Ctrl-C again to leave at once\n".encode())
        elif time.monotonic() - came > _TOGETHER:
            handled.close()
            os.kill(os.getpid(), number)

    with ExitStack() as handled:
        handled.enter_context(signals.taken_over(stop))
        yield kept


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
        """Say for a person how well it matches, why it stopped, the numbers, and what to try."""
        match, names = self.match, list(map(printable, self.outputs))
        result = next((name for name in names if name.endswith(".npz")), "RESULT.npz")
        advice = verdict_words.advice_in_options(match, result)
        lines = [
            verdict_words.headline(match),
            verdict_words.why(match),
            f"mismatch {verdict_words.numbers(match)}, after {len(match.energy_history) - 1} "
            f"iterations in {self.seconds:.1f} s; wrote {', '.join(names)}",
            *([f"to try: {advice}"] if advice else []),
        ]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the same and more for a program."""
        match = self.match
        energies = match.energy_history[-1].tolist()
        return {
            "mismatch": float(match.mismatch),
            "verified_mismatch": _known(match.verified_mismatch),
            "folded": _known(match.folded),
            "verdict": asdict(match.verdict),
            "energy": dict(zip(("total", "regularity", "mismatch"), energies, strict=True)),
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

"""`abfm match`: the main job, and how any match runs here: with signals, progress and files."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

import abfm
from abfm import (
    Control,
    Match,
    Parameters,
    Problem,
    Registration,
    ResultError,
    TriangleMesh,
    load_match,
)
from abfm.errors import printable
from abfm.functions import families
from abfm.matching import bounded, foreseen
from abfm.outcome import Facts
from abfm.types import FloatArray
from abfm_viewer import signals
from abfm_viewer.cli import options, results
from abfm_viewer.cli.exit_status import UNMATCHED, UsageError
from abfm_viewer.cli.progress import long_steps, progress
from abfm_viewer.document import verdict_words
from abfm_viewer.files import outputs

SUMMARY = "find the field whose flow carries a source function to a target"
DESCRIPTION = f"""\
Find the vector field whose flow carries a source function to a target function, and write the
result.

Examples:
  abfm match spot.obj --source gaussian:vertex=12 --target gaussian:vertex=900 --out match.npz
  abfm match spot.obj --source eigenfunction:7 --target eigenfunction:8 --tau 2 --out m.vtu
  abfm match spot.obj --channel hks:time=0.01 file:h.npy 2 --out m.npz --out m.html

The exit status is 0 when source and target are matched or nearly so, or measured functions are
registered, as close as they bear; 3 when the target was not reached or no flow can reach it, with
what to try; 2 for bad input; and 130 or 143 when Ctrl-C or SIGTERM ended the run. The best result
is written in any case but that of bad input.

A function (SPEC) is family:key=value,... and several may be added with +. Families:
  {", ".join(family.family for family in families())}
For example gaussian:vertex=12,width=0.1 or expression:sin(10*x)*z; the README has them all.
"""
_TOGETHER = 0.1  # seconds: `timeout` and terminals may send a signal to a process and to its group


def add_problem(parser: argparse.ArgumentParser) -> None:
    """Declare what is matched, and how."""
    options.add_channels(
        parser, "function to carry along the flow", "function that it should become"
    )
    add = options.adder(parser.add_argument_group("what counts, and where it begins"))
    add(
        "--mask",
        "weight of the mismatch at each vertex, not negative: a function or its file",
        "SPEC",
    )
    add("--start", "start from the field of an earlier result", "RESULT.npz")
    options.add_parameters(parser)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_mesh(parser)
    add_problem(parser)
    add = options.adder(parser.add_argument_group("output"))
    what = (
        "result .npz, or .ply or .vtu for other programs, .csv with the energy, or .html for a "
        "browser: the surfaces, turning, with a time bar; repeatable"
    )
    add("--out", what, "FILE", type=Path, action="append", required=True)
    add("--path", "table of the path, a step a line", "FILE.csv", type=Path)
    options.add_up(add)
    options.add_max_distortion(add)
    add("--json", "print one JSON object about the result")
    add("--quiet", "no progress")


def run(arguments: argparse.Namespace) -> int:
    """Match and write; 3 when the target was not reached, 128 and its number after a signal."""
    sources, targets, weights = options.channels(arguments)
    read = [arguments.mesh, arguments.mask, *sources, *targets]
    for path in arguments.out:
        outputs.check(path, outputs.WRITTEN)
        outputs.check_not_read(path, read)
    if arguments.path is not None:
        outputs.check(arguments.path, (".csv",))
        outputs.check_not_read(arguments.path, read)
        if arguments.path in arguments.out:
            raise UsageError("--path and --out name the same file; give each its own")
    parameters = Parameters.of(**options.given_parameters(arguments))
    with long_steps(arguments.quiet):
        mesh = options.mesh(arguments)
        problem = Problem(
            mesh,
            _alone(sources),
            _alone(targets),
            parameters,
            mask=options.weight(mesh, arguments.mask),
            weights=weights,
            start=_start(mesh, arguments.start, parameters),
        )
    out = Outputs(arguments.out, arguments.path, arguments.up)
    outcome = solve(problem, out, arguments.quiet, arguments.max_distortion)
    outcome.print(arguments, "mesh")
    return outcome.status


def _alone(specs: list[str]) -> list[str] | str:
    return specs if len(specs) > 1 else specs[0]


def _start(mesh: TriangleMesh, path: str | None, parameters: Parameters) -> FloatArray | None:
    if path is None:
        return None
    earlier = load_match(path)
    options.warn_of_doubt(path, earlier)
    if not np.array_equal(earlier.mesh.faces, mesh.faces):
        raise ResultError(
            f"--start {path} is a result on another mesh; give one on a mesh with the same faces"
        )
    return earlier.start_for(parameters)


@dataclass
class Kept:
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


def status_of(facts: Facts, signal: int | None) -> int:
    """Return the exit status of a result, or of a signal that came."""
    if signal is not None:
        return signals.status(signal)
    return 0 if facts.outcome.is_good else UNMATCHED


def warn_if_foreseen(problem: Problem, quiet: bool) -> None:
    """Print what prevents a match and is known before the first iteration; notes unless quiet."""
    found = foreseen(problem)
    if found is not None and not (quiet and found.outcome.is_good):
        kind = "note" if found.outcome.is_good else "warning"
        line = f"{kind}: {found.headline}: {found.reason}; {found.advice}"
        print(printable(line), file=sys.stderr)


@dataclass(frozen=True)
class FinishedMatch:
    """A match, or a registration, that was written to files."""

    found: Match | Registration
    seconds: float
    outputs: Sequence[Path]
    signal: int | None  # that came, also after the last iteration

    @property
    def status(self) -> int:
        """Exit status: 130 or the like when a signal came; 3 when the target was not reached."""
        return status_of(self.found.facts, self.signal)

    def print(self, arguments: argparse.Namespace, *read: str) -> None:
        """Print it, as JSON with the options of these names if that is requested."""
        if arguments.json:
            given = {name: getattr(arguments, name) for name in read}
            print(json.dumps(given | self.to_dict()))
        else:
            print(self.summary())

    def summary(self) -> str:
        """Say for a person how well it matches, why it stopped, the numbers, what the map of a
        registration does, and what to try.
        """
        found, names = self.found, list(map(printable, self.outputs))
        lines = results.told_lines(found, self.seconds, names)
        result = next((name for name in names if name.endswith(".npz")), "RESULT.npz")
        if isinstance(found, Registration):
            lines += [*results.map_lines(found), *results.landmark_lines(found)]
            result = ""  # no registration starts from an earlier one
        if advice := verdict_words.advice_in_options(found, result):
            lines.append(f"to try: {advice}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        found, facts = self.found, results.facts(self.found)
        if isinstance(found, Registration):
            facts |= {"map": results.map_facts(found), **results.initial_facts(found.initial)}
            facts["notes"] = list(found.notes)
        return {**facts, "seconds": self.seconds, "outputs": list(map(str, self.outputs))}


class Outputs(NamedTuple):
    """Files of a result, the table of its path, and the axis that points upwards on pages."""

    files: Sequence[Path]
    path: Path | None = None
    up: str | None = None


def solve(
    problem: Problem,
    out: Outputs,
    quiet: bool = False,
    max_distortion: float | None = None,
    prepared: abfm.registration.Prepared | None = None,
) -> FinishedMatch:
    """Match with progress on stderr and write the result, also after a signal, and its path.

    A ``max_distortion`` bounds what 99% of the faces may change by, see `abfm.matching.bounded`.
    If the problem was ``prepared`` from two surfaces, the result is their registration.
    """
    warn_if_foreseen(problem, quiet)
    control = Control()
    start = time.perf_counter()
    with cancelled_by_signals(control) as kept:
        with progress(problem.parameters.solver.iterations, quiet) as report:
            match = abfm.match(problem, on_iteration=report, control=control)
        found = match if prepared is None else prepared.matched_by(match)
        if max_distortion is not None:
            with long_steps(quiet):
                if isinstance(found, Registration):
                    found = abfm.registration.within(found, max_distortion, control)
                else:
                    found = bounded(found, max_distortion, control=control)
        seconds = time.perf_counter() - start
        if isinstance(found, Registration) and prepared is not None:
            results.print_notes(found.notes[len(prepared.notes) :])
        results.print_notes(outputs.write_all(out.files, found, out.up))
        if out.path is not None and isinstance(found, Match):
            outputs.write_path(out.path, found)
    written = [*out.files, *([] if out.path is None else [out.path])]
    return FinishedMatch(found, seconds, written, kept.number)

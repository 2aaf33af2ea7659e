"""Commands that solve one task: options, progress, output files and report."""

import argparse
import json
import signal
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from abfm.batch import Row
from abfm.display import BEST_VIEW, ViewSpec
from abfm.errors import ColumnError, ParameterError, printable
from abfm.outcome import Facts, Outcome
from abfm.parameters import in_options
from abfm.tasks import Monitor, Task
from abfm.workers.control import CancelledError
from abfm.workers.progress import phase
from abfm_viewer import signals
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import (
    FAILED_STATUS,
    UNMATCHED_STATUS,
    UsageError,
    cancelled_by_signals,
    print_note,
)
from abfm_viewer.cli.explain import help_lines
from abfm_viewer.cli.progress import long_steps, task_progress
from abfm_viewer.files import outputs

_DRAWN_KINDS = ("match", "registration", "sequence")  # of results that `abfm render` draws


class Command:
    def __init__(self, task: type[Task]) -> None:
        self.task, self.SUMMARY, self.DESCRIPTION = task, task.summary, task.description
        self.DETAILS = task.details
        self.MAIN_OPTIONS = (*task.main_options, "out", "json")

    def add_arguments(self, parser: options.Parser) -> None:
        options.add_inputs(parser, self.task.inputs)
        add = options.adder(parser.add_argument_group(options.OUTPUT))
        about = f"{self.task.output_help}; repeatable"
        add("--out", about, "FILE", type=Path, action="append", required=True)
        for name, table in self.task.tables.items():
            add(f"--{name}", table.help, "FILE.csv", type=Path)
        options.add_view(add)
        options.add_report(add)

    def run(self, arguments: argparse.Namespace) -> int:
        """Solve the task, write and print the result, and return the exit status.

        The exit status is 3 if the target was not reached, and 128 plus the number of the signal
        after a signal.
        """
        task = self.task
        row = row_of(arguments, task)
        tables = {name: getattr(arguments, name) for name in task.tables}
        given = {name: path for name, path in tables.items() if path is not None}
        out = Outputs(arguments.out, given, options.view_of(arguments))
        out.check(task, row.files())
        with long_steps(arguments.quiet):
            ready = row.task()
        for path in out.files:
            ready.check_export(path)
        solved = solve(ready, out, arguments.quiet)
        if not arguments.json:
            print(solved.summary())
            return solved.status
        facts = solved.to_dict()
        names = [each.name for each in task.inputs if each.is_argument]
        files = {f"{n}_file" if n in facts else n: getattr(arguments, n) for n in names}
        print(json.dumps(files | facts))
        return solved.status


def row_of(arguments: argparse.Namespace, task: type[Task]) -> Row:
    """Return the checked inputs as a row of a batch; paths begin at the current folder."""
    names = {
        each.name: f"--set {each.name}" if each.is_rare else options.shown_name(each)
        for each in task.inputs
    }
    try:
        return Row("", options.given_texts(arguments, task.inputs), "", task)
    except ParameterError as error:
        text = str(error)
        if isinstance(error, ColumnError):
            text = error.message_with(names.get(error.column, error.column))
        raise UsageError(f"{text}; see {arguments.parser.prog} --help") from error


@dataclass(frozen=True)
class Outputs:
    """Output files of a result, its tables by name, and the axis that points upwards on pages."""

    files: list[Path]
    tables: Mapping[str, Path] = field(default_factory=dict)
    view: ViewSpec = BEST_VIEW

    @property
    def all(self) -> list[Path]:
        return [*self.files, *self.tables.values()]

    def check(self, task: type[Task], read: Iterable[str]) -> None:
        """Refuse files that cannot be written, that are also inputs, or that have the same name."""
        for path in self.files:
            outputs.check_result(path, task)
        for path in self.tables.values():
            outputs.check(path, (".csv",))
        for path in self.all:
            outputs.check_not_read(path, read)
        if len(set(self.all)) < len(self.all):
            raise UsageError("two outputs have the same name; give them different names")


@dataclass(frozen=True)
class Solved:
    task: type[Task]
    result: Any
    seconds: float
    outputs: list[Path]
    status: int
    checkpoints: list[Path]  # only after a signal

    def summary(self, report: Sequence[str] = ()) -> str:
        """Return outcome, reason, next step and files, a line each, and any warnings.

        The lines of a ``report`` replace outcome, reason and warnings.
        """
        names, facts = list(map(printable, self.outputs)), self.result.facts
        file = next((name for name in names if name.endswith(".npz")), "")
        lines = [*report] or [line for line in facts.lines if line]
        if not (facts.is_complete or lines[0].startswith("cancelled")):
            lines[0] = f"cancelled: {lines[0]}"
        if self.checkpoints:
            lines.append(f"run the same command to resume from {printable(self.checkpoints[0])}")
        advice = self.task.report.advice(self.result, file or "RESULT.npz")
        if then := "; ".join([f"advice: {advice}"] * bool(advice) + help_lines(facts)):
            lines.append(then)
        elif page := next((name for name in names if name.endswith(".html")), ""):
            lines.append(f"next: open {page} in a browser")
        elif file and not self.checkpoints and self.task.kind in _DRAWN_KINDS:
            picture = printable(str(Path(file).with_suffix(".png")))
            lines.append(f"next: abfm render {file} --out {picture}")
        about = f"; abfm info {file} prints more" if file else ""
        lines.append(f"wrote {', '.join(names)} in {self.seconds:.1f} s{about}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        details = self.task.report.details(self.result)
        return {**details, "seconds": self.seconds, "outputs": list(map(str, self.outputs))}


def status_of(facts: Facts) -> int:
    if facts.outcome.is_good:
        return 0
    return FAILED_STATUS if facts.outcome is Outcome.FAILED else UNMATCHED_STATUS


def solve(task: Task, out: Outputs, quiet: bool = False, checkpoint: Path | None = None) -> Solved:
    """Solve a task with progress on stderr, and write the result, also after a signal.

    Checkpoints are stored next to the path ``checkpoint``, by default the first output.
    """
    for note in task.notes():
        print_note(note)
    expected = task.expected()
    if expected is not None and not (quiet and expected.outcome.is_good):
        text = f"{expected.headline}: {expected.reason}; {in_options(expected.advice)}"
        print_note(text, "note" if expected.outcome.is_good else "warning")
    start = time.perf_counter()
    with task_progress(quiet) as report:
        monitor = Monitor(
            on_partial=report, on_note=print_note, checkpoint=checkpoint or out.files[0]
        )
        with cancelled_by_signals(monitor.control) as interrupt:
            try:
                result = task.solve(monitor)
            except CancelledError:  # a task without a partial result
                print_note("run the same command to resume; finished rows are kept")
                raise signals.EndedBySignal(interrupt.number or signal.SIGINT) from None
            with phase("check"), suppress(MemoryError):  # the result is written in any case
                _ = result.facts  # measured at first use
            seconds = time.perf_counter() - start
            is_written = True
            try:
                with long_steps(quiet):
                    for note in outputs.write_all(out.files, result, out.view, out.tables):
                        print_note(note)
            except outputs.LostResultError:
                is_written = False
                raise
            finally:
                if is_written and interrupt.number is None:
                    for path in monitor.checkpoints:
                        with suppress(OSError):
                            path.unlink()
    status = interrupt.status or status_of(result.facts)
    checkpoints = [path for path in monitor.checkpoints if path.is_file()]
    return Solved(type(task), result, seconds, out.all, status, checkpoints)

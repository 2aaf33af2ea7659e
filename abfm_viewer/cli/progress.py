"""Progress on stderr: a bar on a terminal, plain lines elsewhere."""

import json
import os
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from abfm.matching import Iteration
from abfm.workers.progress import Step, reporting_steps
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UsageError, print_line
from abfm_viewer.document.verdict_words import residual_text, stage_text

_WARNING_ITERATIONS = 10  # shorter warnings mostly resolve by themselves
_LONG_STEP_SECONDS = 2.0
_TENTHS = _LINES_EVERY = _LINES_OF_A_MOVIE = 10
_BAR = BarColumn(bar_width=None)
_COUNT = TextColumn("{task.completed}/{task.total}")


@contextmanager
def task_progress(quiet: bool) -> Iterator[Callable[[object], None]]:
    """Show the steps of a task; yield a function to call with its partial results.

    A terminal shows a bar. Elsewhere one line is printed per tenth of a counted step, and per ten
    iterations. A warning that persists is printed once, even if ``quiet``.
    """
    latest, printed = "", dict[str, int]()  # the latest step; finished tenths of counted steps
    warned = 0  # consecutive iterations with a warning

    def print_progress(completed: float, text: str, line: str) -> None:
        if line:
            print_line(line)

    def show(step: Step | None) -> None:
        nonlocal latest
        if step is not None:
            tenths = int(_TENTHS * (step.done or 0.0))
            is_new = step.task != latest if step.done is None else tenths != printed.get(step.task)
            line = _line_of(step) if is_new else ""
            latest, printed[step.task] = step.task, tenths
            update(completed=step.done or 0.0, text=step.text(), line=line)

    def report(partial: object) -> None:
        nonlocal warned
        if not isinstance(partial, Iteration):
            return
        stage, residual = stage_text(partial, "sigma"), residual_text(partial)
        text = f"iteration {partial.iteration}: {stage}, {residual}"
        line = "" if partial.iteration % _LINES_EVERY else text
        update(completed=0.0, text=text, line=line)
        warned = warned + 1 if partial.warning or warned >= _WARNING_ITERATIONS else 0
        if warned == _WARNING_ITERATIONS:
            print_line(f"warning: iteration {partial.iteration}: {partial.warning}")

    columns = (_BAR, "{task.fields[text]}", TimeElapsedColumn())
    with (
        _progress_bar(quiet, print_progress, 1.0, *columns, text="starting") as update,
        nullcontext() if quiet else reporting_steps(show),
    ):
        yield report


def _line_of(step: Step) -> str:
    """Return the line to print for a step; empty for a short step."""
    if step.done is None:
        return step.text() if (step.expected or 0) >= _LONG_STEP_SECONDS else ""
    return f"{step.task}: {int(_TENTHS * step.done) * 100 // _TENTHS}%" if step.done > 0 else ""


@contextmanager
def frame_progress(count: int, quiet: bool, machine: bool) -> Iterator[Callable[[int], None]]:
    """Show the progress of a movie; yield a function to call with the number of finished frames.

    If ``machine``, progress is printed to stdout as JSON.
    """
    every = max(count // _LINES_OF_A_MOVIE, 1)

    def print_json(frame: int) -> None:
        print(json.dumps({"frame": frame, "count": count}), flush=True)
        if getattr(sys.stdout, "problem", None):
            raise UsageError("no movie was written, because the reader of its progress is gone")

    def print_progress(completed: int) -> None:
        if completed % every == 0:
            print_line(f"frame {completed} of {count}")

    if machine:
        yield print_json
        return
    columns = ("frame", _BAR, _COUNT, TimeElapsedColumn(), TimeRemainingColumn())
    with _progress_bar(quiet, print_progress, count, *columns) as update:
        yield lambda frame: update(completed=frame)


@contextmanager
def row_progress(
    count: int, quiet: bool, title: str = "rows", reported: Collection[str] = ()
) -> Iterator[Callable[[str], None]]:
    """Show progress; yield a function to call with a line of text for each finished row.

    If the ``count`` of rows is 0, they are not counted, and only terminals show progress. Steps
    whose names begin with a word of ``reported`` are shown as well, without a number.
    """
    done = 0

    def print_progress(completed: int, text: str, is_step: bool = False) -> None:
        if count:
            print_line(text if is_step else f"{completed} of {count}: {text}")

    columns = (title, _BAR, *((_COUNT,) if count else ()), "{task.fields[text]}")
    ends = (TimeElapsedColumn(), TimeRemainingColumn()) if count else (TimeElapsedColumn(),)
    with _progress_bar(
        quiet, print_progress, count or None, *columns, *ends, text="starting"
    ) as update:

        def show(step: Step | None) -> None:
            if step and step.task.startswith(tuple(reported)):
                update(completed=done, text=step.task, is_step=True)

        def report(text: str) -> None:
            nonlocal done
            done += 1
            update(completed=done, text=text)

        with reporting_steps(show):
            yield report


@contextmanager
def share_progress(title: str, quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """Show progress; yield a function of the current work and the completed share, 0 to 1."""
    printed = ""

    def print_progress(completed: float, text: str) -> None:
        nonlocal printed
        if text != printed:
            printed = text
            print_line(f"{title}: {text}")

    columns = (title, _BAR, "{task.fields[text]}", TimeElapsedColumn())
    with _progress_bar(quiet, print_progress, 1.0, *columns, text="") as update:
        yield lambda text, share: update(completed=share, text=text)


@contextmanager
def _progress_bar(
    quiet: bool,
    print_progress: Callable[..., None],
    total: float | None,
    *columns: str | ProgressColumn,
    **state: Any,
) -> Iterator[Callable[..., None]]:
    """Yield a function to call with the new state, which updates a bar or prints a line."""
    if quiet:
        yield lambda **state: None
    elif sys.stderr.isatty():
        with (
            # a signal clears the bar and shows the cursor again
            signals.cleanup_on_signal(partial(os.write, 2, b"\r\x1b[2K\x1b[?25h")),
            Progress(*columns, console=Console(stderr=True), transient=True) as bar,
        ):
            yield partial(bar.update, bar.add_task("", total=total, **state))
    else:
        yield print_progress


def long_steps(quiet: bool) -> AbstractContextManager[None]:
    return nullcontext() if quiet else reporting_steps(_print_long)


def _print_long(step: Step | None) -> None:
    if step and step.done is None and (step.expected or 0) >= _LONG_STEP_SECONDS:
        print_line(step.text())

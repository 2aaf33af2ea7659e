"""Progress on stderr: a bar on a terminal, plain lines elsewhere."""

import json
import os
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    RenderableColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress_bar import ProgressBar
from rich.table import Column
from rich.text import Text

from abfm.matching import Iteration
from abfm.workers.progress import Overall, Step, reporting_steps, rounded_time, within, work_time
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UsageError, print_line
from abfm_viewer.document.verdict_words import SOLVING_PHASES, attempt_text, residual_text

_WARNING_ITERATIONS = 10  # shorter warnings mostly resolve by themselves
_LONG_STEP_SECONDS = 2.0
SILENT_SECONDS = 1.0  # a shorter task prints no lines on its progress
LINE_SECONDS = 30.0  # time after the start of a phase until the first line on its progress
_LINES_OF_A_MOVIE = 10
# the bar and the text share the width of the terminal, so that a long text does not hide the bar
_BAR = BarColumn(bar_width=None, table_column=Column(ratio=1))
_TEXT = TextColumn(
    "{task.fields[text]}",
    markup=False,
    table_column=Column(ratio=2, no_wrap=True, overflow="ellipsis"),
)
_SHORT_BAR = 24  # width of a bar before a text
_COUNT = TextColumn("{task.completed}/{task.total}")


@contextmanager
def task_progress(quiet: bool) -> Iterator[Callable[[object], None]]:
    """Show the progress of a task; yield a function to call with its partial results.

    A terminal shows one line with a bar. Elsewhere a line is printed when a phase, an attempt or a
    mesh begins, and after 30 s, 1 min, 2 min, ... without a line. Nothing is printed in the first
    second. A warning that persists is printed once, even if ``quiet``.
    """
    state, warned = TaskProgress(), 0  # consecutive iterations with a warning

    def show(step: Step | None) -> None:
        state.overall.update(step)
        update()

    def report(partial: object) -> None:
        nonlocal warned
        if not isinstance(partial, Iteration):
            return
        state.iteration, state.iterating = partial, state.overall.name
        update()
        warned = warned + 1 if partial.warning or warned >= _WARNING_ITERATIONS else 0
        if warned == _WARNING_ITERATIONS:
            print_line(f"warning: iteration {partial.iteration}: {partial.warning}")

    def print_progress() -> None:
        if line := state.line():
            print_line(line)

    one_line = Column(no_wrap=True, overflow="ellipsis")  # at the width of the terminal
    columns = RenderableColumn(_Bar(state.overall)), RenderableColumn(state, table_column=one_line)
    with (
        _progress_bar(quiet, print_progress, 1.0, *columns) as update,
        nullcontext() if quiet else reporting_steps(show),
    ):
        yield report


class TaskProgress:
    """The progress of a task as texts of one line."""

    def __init__(self) -> None:
        self.overall = Overall(has_phases=True)
        self.iteration: Iteration | None = None  # the latest one
        self.iterating = ""  # the phase of this iteration
        self._begun = "", ""  # the latest printed phase and its part
        self._printed, self._wait = self.overall.began, LINE_SECONDS

    def text(self) -> str:
        """Return phase, remaining time, part and residual."""
        overall, now = self.overall, self.iteration
        residual = residual_text(now) if now and self._part else ""
        detail = self._part or overall.detail()
        parts = dict.fromkeys((overall.name, overall.text(), detail, residual))  # each once
        return ", ".join(filter(None, parts))

    def __rich__(self) -> Text:
        return Text(self.text(), no_wrap=True, overflow="ellipsis")

    def line(self, now: float | None = None) -> str:
        """Return a line to print at a time, by default now; mostly empty."""
        step, now = self.overall.step, work_time() if now is None else now
        if step is None or now - self.overall.began < SILENT_SECONDS:
            return ""
        outermost = step.chain[-1]
        is_after = self._begun[0].startswith(f"{self.overall.name}, ")  # after an inner phase
        if is_after or (self.overall.name.endswith(SOLVING_PHASES) and not self._part):
            return ""  # until the next phase or the first iteration
        is_long = step.phase or (outermost.expected or 0) >= _LONG_STEP_SECONDS
        begun = self.overall.name, self._part
        if begun != self._begun and (is_long or now - outermost.began >= _LONG_STEP_SECONDS):
            self._begun, self._printed, self._wait = begun, now, LINE_SECONDS
            return ": ".join(filter(None, begun))
        if begun == self._begun and now - self._printed >= self._wait:
            self._printed, self._wait = now, 2 * self._wait
            share = self.overall.share(now)
            done = "" if share is None else f"{share:.0%}"
            elapsed = f"{rounded_time(now - self.overall.began)} so far"
            about = ", ".join(filter(None, (done, elapsed, self.overall.text(now))))
            return f"{begun[0]}: {about}"
        return ""

    @property
    def _part(self) -> str:
        if (now := self.iteration) is None or self.iterating != self.overall.name:
            return ""
        return ", ".join(filter(None, (f"mesh of {now.vertices:,} vertices", attempt_text(now))))


class _Bar(NamedTuple):
    overall: Overall

    def __rich__(self) -> ProgressBar:
        share = self.overall.share()
        return ProgressBar(1.0, share or 0.0, _SHORT_BAR, pulse=share is None)


class _RemainingTime(ProgressColumn):
    max_refresh = 0.5  # seconds

    def render(self, task: Task) -> Text:
        seconds = task.time_remaining
        return Text(within(seconds) if seconds else "")


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
    columns = ("frame", _BAR, _COUNT, TimeElapsedColumn(), _RemainingTime())
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

    columns = (title, _BAR, *((_COUNT,) if count else ()), _TEXT)
    ends = (TimeElapsedColumn(), _RemainingTime()) if count else (TimeElapsedColumn(),)
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

    columns = (title, _BAR, _TEXT, TimeElapsedColumn())
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
        console = Console(stderr=True)
        with (
            # a signal clears the bar and shows the cursor again
            signals.cleanup_on_signal(partial(os.write, 2, b"\r\x1b[2K\x1b[?25h")),
            Progress(*columns, console=console, transient=True, expand=_BAR in columns) as bar,
        ):
            yield partial(bar.update, bar.add_task("", total=total, **state))
    else:
        yield print_progress


def long_steps(quiet: bool) -> AbstractContextManager[None]:
    return nullcontext() if quiet else reporting_steps(_print_long)


def _print_long(step: Step | None) -> None:
    if step and step.done is None and (step.expected or 0) >= _LONG_STEP_SECONDS:
        print_line(step.text())

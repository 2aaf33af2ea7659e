"""How far a match or a movie is: a bar on a terminal, plain lines elsewhere.

On stderr, so that stdout stays for results.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
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

from abfm import Iteration
from abfm.workers.progress import Step, Tell, telling
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.document.verdict_words import place

Report = Callable[[Iteration], None]
_LASTING = 10  # iterations: what looks wrong for less mostly passes
_LONG = 2.0  # seconds
_LINES_EVERY = _LINES_OF_A_MOVIE = 10


@contextmanager
def progress(iterations: int, quiet: bool) -> Iterator[Report]:
    """Yield what to call after every iteration, `iterations` at most; what looks wrong early is
    said once, quiet or not.

    What else takes long meanwhile is told, too, with an estimate.
    """
    warn = _Warner()
    if quiet:
        yield warn
    elif sys.stderr.isatty():
        numbers = TextColumn("energy {task.fields[energy]}  mismatch {task.fields[mismatch]}")
        columns = (
            *_counted("{task.fields[place]}"),
            numbers,
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with (
            _bar(columns, iterations, place="starting", energy="-", mismatch="-") as update,
            telling(_shown_by(update)),
        ):

            def show(now: Iteration) -> None:
                warn(now)
                update(
                    completed=now.iteration,
                    place=place(now),
                    energy=f"{now.energy:.4g}",
                    mismatch=f"{now.mismatch:.4f}",
                )

            yield show
    else:

        def say(now: Iteration) -> None:
            _print_line(now)
            warn(now)

        with telling(_print_long):
            yield say


def _shown_by(update: Callable[..., None]) -> Tell:
    return lambda step: update(place=step.words()) if step else None


@contextmanager
def long_steps(quiet: bool) -> Iterator[None]:
    """Say what takes seconds, with an estimate, when it begins."""
    with nullcontext() if quiet else telling(_print_long):
        yield


def _print_long(step: Step | None) -> None:
    """Print a line for a step that is expected to take seconds, when it begins."""
    if step and step.done is None and (step.expected or 0) >= _LONG:
        print(step.words(), file=sys.stderr, flush=True)


class _Warner:
    """Says on stderr what looks wrong while a match runs, once, and not if it may pass."""

    def __init__(self) -> None:
        self._held = 0  # iterations in a row in which something looked wrong

    def __call__(self, now: Iteration) -> None:
        if self._held < _LASTING:
            self._held = self._held + 1 if now.warning else 0
            if self._held == _LASTING:
                print(
                    f"warning: iteration {now.iteration}: {now.warning}",
                    file=sys.stderr,
                    flush=True,
                )


def _counted(title: str) -> tuple[ProgressColumn, ...]:
    return TextColumn(title), BarColumn(bar_width=None), TextColumn("{task.completed}/{task.total}")


@contextmanager
def _bar(
    columns: tuple[ProgressColumn, ...], total: float, **fields: Any
) -> Iterator[Callable[..., None]]:
    """Show a bar, and yield what to call with its new state."""
    with (
        signals.tidied(_take_away),
        Progress(*columns, console=Console(stderr=True), transient=True) as bar,
    ):
        task = bar.add_task("", total=total, **fields)

        def update(**state: Any) -> None:
            bar.update(task, **state)

        yield update


def _take_away() -> None:
    """Clear the line of a bar that a signal ended, and show the cursor again."""
    os.write(2, b"\r\x1b[2K\x1b[?25h")


def _print_line(now: Iteration) -> None:
    if now.iteration % _LINES_EVERY == 0:
        line = (
            f"iteration {now.iteration}  {place(now)}  energy {now.energy:.4g}  mismatch "
            f"{now.mismatch:.4f}"
        )
        print(line, file=sys.stderr, flush=True)


@contextmanager
def frame_progress(count: int, quiet: bool, machine: bool) -> Iterator[Callable[[int], None]]:
    """Yield what to call with the number of frames that are done, of `count`; for a machine a line
    of JSON on stdout each.
    """
    if machine:

        def tell(frame: int) -> None:
            print(json.dumps({"frame": frame, "count": count}), flush=True)
            if getattr(sys.stdout, "problem", None):
                raise UsageError("no movie: who asked for its progress has gone")

        yield tell
    elif quiet:
        yield lambda frame: None
    elif sys.stderr.isatty():
        with _bar(
            (*_counted("frame"), TimeElapsedColumn(), TimeRemainingColumn()), count
        ) as update:
            yield lambda frame: update(completed=frame)
    else:
        step = max(count // _LINES_OF_A_MOVIE, 1)

        def print_some(frame: int) -> None:
            if frame % step == 0:
                print(f"frame {frame} of {count}", file=sys.stderr, flush=True)

        yield print_some


@contextmanager
def share_progress(title: str, quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """Yield what to call with what is being done, in a few words, and which share of everything is
    behind it.
    """
    if quiet:
        yield lambda text, share: None
    elif sys.stderr.isatty():
        columns = (
            TextColumn(title),
            BarColumn(bar_width=None),
            TextColumn("{task.fields[text]}"),
            TimeElapsedColumn(),
        )
        with _bar(columns, 1.0, text="") as update:
            yield lambda text, share: update(completed=share, text=text)
    else:
        said = ""

        def print_new(text: str, share: float) -> None:
            nonlocal said
            if text != said:
                said = text
                print(f"{title}: {text}", file=sys.stderr, flush=True)

        yield print_new

"""How far work is, on stderr: a bar on a terminal, plain lines elsewhere."""

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

from abfm import Iteration
from abfm.workers.progress import Step, telling
from abfm_viewer import signals
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.document.verdict_words import place

_LASTING = 10  # iterations: what looks wrong for less mostly passes
_LONG = 2.0  # seconds
_TENTHS = _LINES_EVERY = _LINES_OF_A_MOVIE = 10
_BAR, _COUNT = BarColumn(bar_width=None), TextColumn("{task.completed}/{task.total}")
_NUMBERS = TextColumn("energy {task.fields[energy]}  residual {task.fields[residual]}")


@contextmanager
def progress(iterations: int, quiet: bool) -> Iterator[Callable[[Iteration], None]]:
    """Yield what to call after every iteration; a warning that lasts is said once, quiet or not."""
    held = 0  # iterations in a row in which something looked wrong

    def say(place: str, completed: int, energy: str, residual: str) -> None:
        if completed % _LINES_EVERY == 0:
            _say(f"iteration {completed}  {place}  energy {energy}  residual {residual}")

    def report(now: Iteration) -> None:
        nonlocal held
        numbers = {"energy": f"{now.energy:.4g}", "residual": f"{now.residual:.4f}"}
        update(place=place(now), completed=now.iteration, **numbers)
        if held < _LASTING:
            held = held + 1 if now.warning else 0
            if held == _LASTING:
                _say(f"warning: iteration {now.iteration}: {now.warning}")

    def show(step: Step | None) -> None:
        if step:
            update(place=step.words())

    columns = ("{task.fields[place]}", _BAR, _COUNT, _NUMBERS, TimeElapsedColumn())
    blank = {"place": "starting", "energy": "-", "residual": "-"}
    tell = show if sys.stderr.isatty() else print_long
    with (
        _told(quiet, say, iterations, *columns, TimeRemainingColumn(), **blank) as update,
        nullcontext() if quiet else telling(tell),
    ):
        yield report


@contextmanager
def frame_progress(count: int, quiet: bool, machine: bool) -> Iterator[Callable[[int], None]]:
    """Yield what to call with the number of frames done; for a machine JSON lines on stdout."""
    every = max(count // _LINES_OF_A_MOVIE, 1)

    def tell(frame: int) -> None:
        print(json.dumps({"frame": frame, "count": count}), flush=True)
        if getattr(sys.stdout, "problem", None):
            raise UsageError("no movie: who asked for its progress has gone")

    def say(completed: int) -> None:
        if completed % every == 0:
            _say(f"frame {completed} of {count}")

    if machine:
        yield tell
        return
    columns = ("frame", _BAR, _COUNT, TimeElapsedColumn(), TimeRemainingColumn())
    with _told(quiet, say, count, *columns) as update:
        yield lambda frame: update(completed=frame)


@contextmanager
def row_progress(
    count: int, quiet: bool, title: str = "rows", reported: Collection[str] = ()
) -> Iterator[Callable[[str], None]]:
    """Yield what to call with a line about each of so many rows once it is done; of 0 they are not
    counted, and lines are for terminals alone. Steps whose names begin so are reported, too.
    """
    done = 0

    def say(completed: int, text: str) -> None:
        if count:
            _say(f"{completed} of {count}: {text}")

    columns = (title, _BAR, *((_COUNT,) if count else ()), "{task.fields[text]}")
    ends = (TimeElapsedColumn(), TimeRemainingColumn()) if count else (TimeElapsedColumn(),)
    with _told(quiet, say, count or None, *columns, *ends, text="starting") as update:

        def show(step: Step | None) -> None:
            if step and step.task.startswith(tuple(reported)):
                update(completed=done, text=step.task)

        def tell(text: str) -> None:
            nonlocal done
            done += 1
            update(completed=done, text=text)

        with telling(show):
            yield tell


@contextmanager
def steps_progress(quiet: bool) -> Iterator[None]:
    """Tell of the steps of work meanwhile: a bar of that which is counted, or a line a tenth."""
    said = "", 0

    def say(completed: float | None, text: str, task: str) -> None:
        nonlocal said
        now = task, int(_TENTHS * (completed or 0.0))
        if now[1] and now != said:
            said = now
            _say(f"{task}: {100 * now[1] // _TENTHS}%")

    def tell(step: Step | None) -> None:
        if step:
            update(completed=step.done, text=step.words(), task=step.task)
        if not sys.stderr.isatty():
            print_long(step)

    columns = (_BAR, "{task.fields[text]}", TimeElapsedColumn())
    with (
        _told(quiet, say, 1.0, *columns, text="") as update,
        nullcontext() if quiet else telling(tell),
    ):
        yield


@contextmanager
def share_progress(title: str, quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """Yield what to call with what is being done, and the share that is behind it."""
    said = ""

    def say(completed: float, text: str) -> None:
        nonlocal said
        if text != said:
            said = text
            _say(f"{title}: {text}")

    columns = (title, _BAR, "{task.fields[text]}", TimeElapsedColumn())
    with _told(quiet, say, 1.0, *columns, text="") as update:
        yield lambda text, share: update(completed=share, text=text)


@contextmanager
def _told(
    quiet: bool,
    say: Callable[..., None],
    total: float | None,
    *columns: str | ProgressColumn,
    **state: Any,
) -> Iterator[Callable[..., None]]:
    """Yield what to call with the new state, for a bar of these columns or a line that is said."""
    if quiet:
        yield lambda **state: None
    elif sys.stderr.isatty():
        with (
            # a signal clears the line of the bar and shows the cursor again
            signals.tidied(partial(os.write, 2, b"\r\x1b[2K\x1b[?25h")),
            Progress(*columns, console=Console(stderr=True), transient=True) as bar,
        ):
            yield partial(bar.update, bar.add_task("", total=total, **state))
    else:
        yield say


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def long_steps(quiet: bool) -> AbstractContextManager[None]:
    """Print the steps of work that take seconds."""
    return nullcontext() if quiet else telling(print_long)


def print_long(step: Step | None) -> None:
    if step and step.done is None and (step.expected or 0) >= _LONG:
        _say(step.words())

"""How far a match or a movie is: a bar on a terminal, plain lines elsewhere.

On stderr, so that stdout stays for results.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from abfm import Iteration
from abfm_viewer.document.verdict_words import place

Report = Callable[[Iteration], None]
_LINES_EVERY = 10
_LINES_OF_A_MOVIE = 10


@contextmanager
def progress(iterations: int, quiet: bool) -> Iterator[Report]:
    """What to call after every iteration, `iterations` at most."""
    if quiet:
        yield lambda _: None
    elif sys.stderr.isatty():
        with _bar(iterations) as report:
            yield report
    else:
        yield _print_line


@contextmanager
def _bar(iterations: int) -> Iterator[Report]:
    columns = (
        TextColumn("{task.fields[place]}"),
        BarColumn(bar_width=None),
        TextColumn("{task.completed}/{task.total}"),
        TextColumn("energy {task.fields[energy]}  mismatch {task.fields[mismatch]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=iterations, place="-", energy="-", mismatch="-")

        def report(now: Iteration) -> None:
            bar.update(
                task,
                completed=now.iteration,
                place=place(now),
                energy=f"{now.energy:.4g}",
                mismatch=f"{now.mismatch:.4f}",
            )

        yield report


def _print_line(now: Iteration) -> None:
    if now.iteration % _LINES_EVERY == 0:
        print(
            f"iteration {now.iteration}  {place(now)}  energy {now.energy:.4g}  mismatch {now.mismatch:.4f}",
            file=sys.stderr,
            flush=True,
        )


@contextmanager
def frame_progress(count: int, quiet: bool, machine: bool) -> Iterator[Callable[[int], None]]:
    """What to call with the number of frames that are done, of `count`; for a machine a line of JSON on stdout each."""
    if machine:
        yield lambda frame: print(json.dumps({"frame": frame, "count": count}), flush=True)
    elif quiet:
        yield lambda frame: None
    elif sys.stderr.isatty():
        columns = (TextColumn("frame"), BarColumn(bar_width=None), TextColumn("{task.completed}/{task.total}"))
        console = Console(stderr=True)
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True) as bar:
            task = bar.add_task("", total=count)
            yield lambda frame: bar.update(task, completed=frame)
    else:
        step = max(count // _LINES_OF_A_MOVIE, 1)

        def print_some(frame: int) -> None:
            if frame % step == 0:
                print(f"frame {frame} of {count}", file=sys.stderr, flush=True)

        yield print_some


@contextmanager
def share_progress(title: str, quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """What to call with what is being done, in a few words, and which share of everything is behind it."""
    if quiet:
        yield lambda text, share: None
    elif sys.stderr.isatty():
        columns = (TextColumn(title), BarColumn(bar_width=None), TextColumn("{task.fields[text]}"))
        with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("", total=1.0, text="")
            yield lambda text, share: bar.update(task, completed=share, text=text)
    else:
        said = ""

        def print_new(text: str, share: float) -> None:
            nonlocal said
            if text != said:
                said = text
                print(f"{title}: {text}", file=sys.stderr, flush=True)

        yield print_new

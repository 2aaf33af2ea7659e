"""How far a match is: a bar on a terminal, plain lines elsewhere; on stderr, so that stdout stays for results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from abfm import Iteration

Report = Callable[[Iteration], None]
_LINES_EVERY = 10


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
        TextColumn("stage {task.fields[stage]}"),
        BarColumn(bar_width=None),
        TextColumn("{task.completed}/{task.total}"),
        TextColumn("energy {task.fields[energy]}  mismatch {task.fields[mismatch]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=iterations, stage="-", energy="-", mismatch="-")

        def report(now: Iteration) -> None:
            bar.update(
                task,
                completed=now.iteration,
                stage=f"{now.stage + 1}/{now.stages}",
                energy=f"{now.energy:.4g}",
                mismatch=f"{now.mismatch:.4f}",
            )

        yield report


def _print_line(now: Iteration) -> None:
    if now.iteration % _LINES_EVERY == 0:
        print(
            f"iteration {now.iteration}  stage {now.stage + 1}/{now.stages}  "
            f"energy {now.energy:.4g}  mismatch {now.mismatch:.4f}",
            file=sys.stderr,
            flush=True,
        )

"""Tables and command line of the benchmarks, and a description of the machine."""

import argparse
import os
import platform
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from runpy import run_module
from typing import Any, NamedTuple, TypeVar

Cells = Sequence[str]
Report = dict[str, Any]
"""Numbers, text, lists and dictionaries, for a JSON file."""
Log = Callable[[str], None]
"""Prints a line of progress."""

_CPU_INFO = Path("/proc/cpuinfo")
_PACKAGES = ("numpy", "scipy", "numba")

Argument = TypeVar("Argument")
Result = TypeVar("Result")


class Table(NamedTuple):
    """A table of the documentation: headings, and rows that are computed one by one."""

    headings: Cells
    rows: Iterable[Cells]


def markdown(headings: Cells, rows: Iterable[Cells]) -> str:
    """Return a table in Markdown, with the cells of each column aligned."""
    body = [*rows]
    widths = [max(3, *map(len, column)) for column in zip(headings, *body, strict=True)]
    lines = (headings, ["-" * width for width in widths], *body)
    return "\n".join(f"| {' | '.join(map(str.ljust, line, widths))} |" for line in lines)


def decimals(value: float | None, form: str = ".3g", missing: str = "none") -> str:
    """Return a number as text, or the text ``missing`` if it is None, infinite or NaN."""
    return missing if value is None or not abs(value) < float("inf") else f"{value:{form}}"


def main(
    description: str | None,
    tables: Callable[[argparse.Namespace], Mapping[str, Table]],
    required: Mapping[str, str] | None = None,
    **options: str,
) -> None:
    """Run a benchmark from the command line: compute its tables, print them, write them to a page.

    Parameters
    ----------
    tables : function
        Function that takes the parsed options and returns all tables of the benchmark by name. The
        rows of a table are computed only if the options request it.
    required, **options : str
        Options whose values are paths: the name of each option, and its help text. The options in
        ``required`` have to be given, the other ones are optional.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, about in {**(required or {}), **options}.items():
        is_required = name not in options
        parser.add_argument(f"--{name}", help=about, type=Path, required=is_required)
    parser.add_argument("--jobs", type=int, help="parallel processes (default: all cores)")
    parser.add_argument("--only", nargs="+", metavar="TABLE", help="compute only these tables")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="replace the tables of a page")
    arguments = parser.parse_args()
    named = tables(arguments)
    if unknown := {*(arguments.only or ())} - named.keys():
        parser.error(f"unknown table {min(unknown)}; expected {', '.join(named)}")
    for name in arguments.only or named:
        text = markdown(named[name].headings, _reported(named[name].rows))
        print(f"{name}\n\n{text}\n", flush=True)
        if arguments.write:
            put_between(arguments.write, name, text)


def _reported(rows: Iterable[Cells]) -> Iterator[Cells]:
    for row in rows:
        print(", ".join(row), file=sys.stderr, flush=True)
        yield row


def put_between(page: Path, name: str, text: str) -> None:
    """Replace the table ``name`` of a Markdown page, between the comments at its start and end."""
    before, start, rest = page.read_text(encoding="utf-8").partition(f"<!-- table: {name} -->")
    _, end, after = rest.partition(f"<!-- end: {name} -->")
    if not end:
        raise SystemExit(f"{page} has no comments around the table {name}")
    page.write_text(f"{before}{start}\n\n{text}\n\n{end}{after}", encoding="utf-8")


def bench(*words: str) -> None:
    """Run ``abfm bench`` with the given arguments, followed by the arguments of this process."""
    sys.argv[1:1] = ["bench", *words]
    run_module("abfm_viewer.cli", run_name="__main__")


def mapped(
    function: Callable[[Argument], Result], arguments: Sequence[Argument], jobs: int | None
) -> Iterator[Result]:
    """Apply a module-level function to each argument, and yield the results in the same order.

    There are ``jobs`` processes of one thread each, by default one per core.
    """
    jobs = min(jobs or os.cpu_count() or 1, len(arguments))
    if jobs <= 1:
        yield from map(function, arguments)
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(jobs, get_context("spawn")) as executor:
        yield from executor.map(function, arguments)


def fsaverage5() -> Path:
    spec = find_spec("nilearn")
    if spec is None or spec.origin is None:
        raise SystemExit('nilearn is not installed: pip install "abfm[brain]"')
    return Path(spec.origin).parent / "datasets/data/fsaverage5"


def machine() -> dict[str, str | int]:
    """Return the processor, logical cores, system, and versions of the numerical packages."""
    text = _CPU_INFO.read_text(encoding="utf-8") if _CPU_INFO.exists() else ""
    model = re.search(r"model name\s*: (.*)", text)
    return {
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{package: version(package) for package in _PACKAGES},
    }


def machine_line(machine: Mapping[str, str | int]) -> str:
    packages = ", ".join(f"{name} {machine[name]}" for name in ("python", *_PACKAGES))
    return f"{machine['processor']}, {machine['cores']} cores, {machine['system']}; {packages}"

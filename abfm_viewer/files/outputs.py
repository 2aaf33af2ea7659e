"""Output files: refused before hours of work, and written by their suffix."""

from __future__ import annotations

import os
import re
import secrets
import tempfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import abfm
from abfm import AbfmError, ResultError
from abfm.errors import one_line, printable
from abfm.io import results, write_atomically

if TYPE_CHECKING:
    from PIL import Image

    from abfm.tasks import Task

FPS_MIN = 0.1
# frames a second by suffix; browsers slow down a GIF that is faster
FPS_MAX = {".mp4": 120.0, ".gif": 50.0}


def suffixes(task: type[Task]) -> tuple[str, ...]:
    """Return the suffixes of files that results of a kind of task can be written to."""
    return (".npz", *task.exports, ".html")


def check_result(path: Path, task: type[Task]) -> None:
    """Refuse a path that no result of a kind of task could be written to."""
    check(path, suffixes(task))
    if path.suffix in task.exports:
        task.exports[path.suffix].check(path)


def check(path: Path, suffixes: Collection[str]) -> None:
    """Refuse a path that could not be written, by a `ResultError` that says why and what to do."""
    if path.suffix not in suffixes:
        raise ResultError(f"cannot write {path}: its name must end in {', '.join(suffixes)}")
    check_folder(path)


def check_folder(path: Path) -> None:
    """Refuse a path that could not be written, whatever its suffix."""
    if path.parent.exists() and not path.parent.is_dir():
        raise ResultError(f"cannot write {path}: {path.parent} is no folder; choose another place")
    if not path.parent.is_dir():
        raise ResultError(f"cannot write {path}: there is no folder {path.parent}; make it first")
    abfm.io.check_writable(path)


def check_not_read(path: Path, read: Iterable[str | None]) -> None:
    """Refuse a path of a file that the same command reads, also by the text of a function, and a
    .pvd whose frames would lie among those that are read.
    """
    for name in (name for each in read if each is not None for name in _files_in(each)):
        other = Path(os.path.expanduser(name))
        among = re.fullmatch(rf"{re.escape(path.stem)}_[0-9]+\.vtu", other.name)
        frame = path.with_suffix("") / other.name
        written = [path, frame] if path.suffix == ".pvd" and among else [path]
        for place in written:
            if os.path.exists(other) and os.path.exists(place) and place.samefile(other):
                named = "it" if place is path else f"its {other.name}"
                raise ResultError(f"cannot write {path}: {named} is read; choose another name")


def _files_in(text: str) -> list[str]:
    """Return the names of files that a text may mean: itself, or those of a function."""
    found = [text]

    def seen(name: str) -> str:
        found.append(name)
        return name

    with suppress(AbfmError):
        abfm.tasks.renamed_spec(text, seen)
    return found


class LostResultError(ResultError):
    """A result that could be written nowhere."""


def make_folder(path: Path) -> None:
    """Make a folder for output unless it is there; a `ResultError` says why that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise ResultError(
            f"cannot make the folder {path}: {one_line(error)}; choose another"
        ) from None


def write(path: Path, found: Any, up: str | None = None) -> str:
    """Write a result by the suffix; ``up`` is the axis that points upwards on a page. Return what
    the file lacks and why, in a line; empty if nothing.
    """
    if path.suffix == ".npz":
        return results.save_what_can_be(path, found)
    if path.suffix == ".html":
        abfm.pages.page_of(found, printable(path.stem), up).write(path)
        return ""
    return str(abfm.loading.task_of(found).exports[path.suffix].write(path, found) or "")


def write_all(
    paths: Sequence[Path],
    found: Any,
    up: str | None = None,
    tables: Mapping[str, Path] | None = None,
) -> list[str]:
    """Write a result to several files, and its tables by their names; return what files lack, a
    line each.

    If a file cannot be written the result is kept elsewhere, unless a result file holds it, and a
    ResultError reports that.
    """
    writers: dict[Path, Callable[[], object]] = {
        path: partial(write, path, found, up) for path in paths
    }
    for name, path in (tables or {}).items():
        writers[path] = partial(abfm.loading.task_of(found).tables[name].write, path, found)
    problem, kept, notes = None, False, []
    for path, write_file in writers.items():
        try:
            note = str(write_file() or "")
        except Exception as error:  # whatever goes wrong, the result is kept
            problem = problem or error
        else:
            kept = kept or path.suffix == ".npz"
            notes += [note] if note else []
    if problem is None:
        return notes
    reason = one_line(problem) if isinstance(problem, AbfmError) else f"not written: {problem!r}"
    if kept:
        raise ResultError(reason) from problem
    if place := _kept_elsewhere(found):
        raise ResultError(f"{reason}; the result is in {place}") from problem
    raise LostResultError(f"{reason}; there was no other place for the result either") from problem


def _kept_elsewhere(whole: results.Saved) -> str:
    """Save a result in a folder that can be written; return its place, or nothing."""
    for folder in (Path.cwd, Path.home, tempfile.gettempdir):
        with suppress(Exception):
            place = Path(folder()) / f"abfm-{secrets.token_hex(4)}.npz"
            missing = results.save_what_can_be(place, whole)
            return f"{place}{f'; {missing}' if missing else ''}"
    return ""


def write_text(path: Path, text: str) -> None:
    """Write a text, whole or not at all, with question marks for what UTF-8 cannot encode."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def write_picture(path: Path, picture: Image.Image) -> None:
    with write_atomically(path) as temporary:
        picture.save(temporary)

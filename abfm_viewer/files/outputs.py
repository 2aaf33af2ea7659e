"""Output files: checks before a long computation, and writing in the format of the suffix."""

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
from abfm.display import BEST_VIEW, ViewSpec
from abfm.errors import one_line, printable
from abfm.io import results, write_atomically

if TYPE_CHECKING:
    from PIL import Image

    from abfm.tasks import Task

DPI = 300.0  # of printed pictures, in pixels per inch
FPS_MIN = 0.1
# frames per second by suffix; browsers slow down faster GIFs
FPS_MAX = {".mp4": 120.0, ".gif": 50.0}


def suffixes(task: type[Task]) -> tuple[str, ...]:
    return (".npz", *task.exports, ".html")


def check_result(path: Path, task: type[Task]) -> None:
    check(path, suffixes(task))
    if path.suffix in task.exports:
        task.exports[path.suffix].check(path)


def check(path: Path, suffixes: Collection[str]) -> None:
    """Raise a `ResultError` if a file cannot be written, or its suffix is not in ``suffixes``."""
    if path.suffix not in suffixes:
        raise ResultError(f"cannot write {path}: its name must end in {', '.join(suffixes)}")
    check_folder(path)


def check_folder(path: Path) -> None:
    """Raise a `ResultError` if a file cannot be written to its folder; any suffix is allowed."""
    if path.parent.exists() and not path.parent.is_dir():
        raise ResultError(
            f"cannot write {path}: {path.parent} is not a folder; choose another folder"
        )
    if not path.parent.is_dir():
        raise ResultError(f"cannot write {path}: folder {path.parent} does not exist; create it")
    abfm.io.check_writable(path)


def check_not_read(path: Path, read: Iterable[str | None]) -> None:
    """Raise a `ResultError` if writing a file would overwrite an input of the same command.

    ``read`` are the inputs: paths, and specs of functions, which may name files. For a .pvd file,
    the files of its frames are checked as well.
    """
    for name in (name for each in read if each is not None for name in _files_in(each)):
        other = Path(os.path.expanduser(name))
        is_frame = re.fullmatch(rf"{re.escape(path.stem)}_[0-9]+\.vtu", other.name)
        frame = path.with_suffix("") / other.name
        written = [path, frame] if path.suffix == ".pvd" and is_frame else [path]
        for place in written:
            if os.path.exists(other) and os.path.exists(place) and place.samefile(other):
                file = "it" if place is path else f"its frame {other.name}"
                raise ResultError(
                    f"cannot write {path}: {file} is also an input; choose another name"
                )


def _files_in(text: str) -> list[str]:
    """Return the files that an input may name: the text itself, and files in it as a spec."""
    found = [text]

    def collect(name: str) -> str:
        found.append(name)
        return name

    with suppress(AbfmError):
        abfm.tasks.renamed_spec(text, collect)
    return found


class LostResultError(ResultError):
    """Error that a result could not be written anywhere, and so is lost."""


def make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise ResultError(
            f"cannot create the folder {path}: {one_line(error)}; choose another folder"
        ) from None


def write(path: Path, found: Any, view: ViewSpec = BEST_VIEW) -> str:
    """Write a result in the format of the suffix; return a note about what the file lacks.

    The note is one line, or empty. ``view`` is the view of an HTML page.
    """
    if path.suffix == ".npz":
        return results.save_with_fallback(path, found)
    if path.suffix == ".html":
        abfm.pages.page_of(found, printable(path.stem), view).write(path)
        return ""
    return str(abfm.loading.task_of(found).exports[path.suffix].write(path, found) or "")


def write_all(
    paths: Sequence[Path],
    found: Any,
    view: ViewSpec = BEST_VIEW,
    tables: Mapping[str, Path] | None = None,
) -> list[str]:
    """Write a result to several files, and its tables, whose files ``tables`` gives by name.

    Return notes about files that lack something, one line each. If a file cannot be written, the
    other files are, and a `ResultError` is raised. Unless a result file (.npz) was written, the
    result is then saved in another folder. ``view`` is the view of an HTML page.
    """
    writers: dict[Path, Callable[[], object]] = {
        path: partial(write, path, found, view) for path in paths
    }
    for name, path in (tables or {}).items():
        writers[path] = partial(abfm.loading.task_of(found).tables[name].write, path, found)
    problem, is_saved, notes = None, False, []
    for path, write_file in writers.items():
        try:
            note = str(write_file() or "")
        except Exception as error:  # after any error the result must be saved
            problem = problem or error
        else:
            is_saved = is_saved or path.suffix == ".npz"
            notes += [note] if note else []
    if problem is None:
        return notes
    reason = one_line(problem) if isinstance(problem, AbfmError) else f"not written: {problem!r}"
    if is_saved:
        raise ResultError(reason) from problem
    if place := _save_elsewhere(found):
        raise ResultError(f"{reason}; the result is in {place}") from problem
    raise LostResultError(
        f"{reason}; the result could not be saved in any other folder"
    ) from problem


def _save_elsewhere(found: results.Saved) -> str:
    """Save a result in the first writable folder; return its path, or an empty text if this fails.

    The path may be followed by a note. The folders are the current one, the user's, and a temporary
    one.
    """
    for folder in (Path.cwd, Path.home, tempfile.gettempdir):
        with suppress(Exception):
            place = Path(folder()) / f"abfm-{secrets.token_hex(4)}.npz"
            note = results.save_with_fallback(place, found)
            return f"{place}{f'; {note}' if note else ''}"
    return ""


def write_text(path: Path, text: str) -> None:
    """Write a text atomically; characters that UTF-8 cannot encode become question marks."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace", newline="\n")


def write_picture(path: Path, picture: Image.Image, dpi: float | None = None) -> None:
    """Write a PNG picture, which is printed with ``dpi`` pixels per inch, by default 300."""
    with write_atomically(path) as temporary:
        picture.save(temporary, dpi=(dpi or DPI, dpi or DPI))

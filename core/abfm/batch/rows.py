"""One of many problems, as paths and options: cheap to keep, to send and to tell from others."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from abfm.batch.kinds import KINDS, TASK, kind_of
from abfm.errors import ParameterError, brief, did_you_mean, printable
from abfm.matching.problem import Problem
from abfm.reading import open_plain, referenced_file
from abfm.sequences.reading.vtk_frames import files_of_frames
from abfm.tasks.inputs import Input, Rename, absolute, by_name
from abfm.tasks.task import Task

PROBLEMS = "problems"
"""Folder, in that of results, of problems that were made in Python."""
_BLOCK = 1 << 20
_URI = re.compile(rb'"uri"\s*:\s*"((?!data:)[^"]{1,1000})"')
_LARGEST_JSON = 64 << 20  # bytes of a glTF file that may name others


@dataclass(frozen=True)
class Row:
    """A problem as a row of a table has it. Nothing is read before it is asked for.

    Parameters
    ----------
    name : str
        What it is called; characters that cannot be printed become question marks.
    options : mapping of str, or pairs
        Texts by column, named as the options of `abfm match` and `abfm register`: ``mesh``,
        ``source``, ``target``, ``alpha``, ...; ``a`` and ``b`` for a registration. Pairs may have
        ``channel`` several times, also as source, target and weight. Numbers and paths become
        texts; what is None or empty counts as not given.
    folder : path, optional
        Where relative paths begin; by default the current folder. If it is empty, paths stay as
        they are.
    task : type, optional
        The kind of task; by default that which the column ``task`` names, or whose
        columns are given.

    Raises
    ------
    ParameterError
        If the columns are those of no kind of row, or a value does not fit.
    """

    name: str
    options: tuple[tuple[str, str], ...]
    folder: str
    declared: type[Task]

    def __init__(
        self,
        name: str,
        options: Mapping[str, Any] | Iterable[tuple[str, Any]],
        folder: str | os.PathLike[str] = ".",
        task: type[Task] | None = None,
    ) -> None:
        pairs = options.items() if isinstance(options, Mapping) else options
        given = tuple((column, _text(value)) for column, value in pairs)
        given = tuple((column, text) for column, text in given if text)
        task = task or kind_of(dict(given))
        kind, known = task.kind, _columns(task)
        seen = set[str]()
        for column, text in given:
            if column not in known:
                raise ParameterError(
                    f"column {column}: a {kind} has no such option{did_you_mean(column, known)}"
                )
            if column in seen and not known[column].repeats:
                raise ParameterError(f"column {column}: it is given twice")
            seen.add(column)
            try:
                known[column].read(text)
            except ValueError as error:
                raise ParameterError(f"column {column}: {error}") from None
        missing = [column for column in task.needs if column not in seen]
        if missing:
            raise ParameterError(f"column {missing[0]}: a {kind} needs it, and it is empty")
        folder = os.path.abspath(os.path.expanduser(folder)) if folder else ""
        self.__dict__.update(
            name=printable(" ".join(str(name).split())),
            options=given,
            folder=folder,
            declared=task,
        )
        self.declared.check(self.values())

    @property
    def kind(self) -> str:
        """The name of its kind of task."""
        return self.declared.kind

    def values(self) -> dict[str, Any]:
        """Return the options' values by column, repeated ones as lists; names of files that are in
        them are absolute.
        """
        return self._values(self._resolved())

    @cached_property
    def key(self) -> str:
        """Name by options and contents of files, in hexadecimal digits, wherever these lie: what
        is not read, such as a file that is missing, has a key, too.
        """
        told = [self.kind, own_version()]
        columns = _columns(self.declared)
        for column, text in sorted(self._resolved()):
            hashed = columns[column].renamed(text, _content)
            told.append(f"{column} {columns[column].read(hashed)!r}")
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()

    @cached_property
    def digest(self) -> str:
        """Name of the result, in hexadecimal digits: of a match that of its `Problem`, which is
        made for it; an AbfmError tells why that cannot be.
        """
        return self.task().digest

    def task(self) -> Task:
        """Read the files that it names; an AbfmError reports what does not fit."""
        return self.declared.read(self)

    def told(self) -> dict[str, Any]:
        """Return what it is made of, as plain lists and texts."""
        return {"name": self.name, "options": list(map(list, self.options)), "folder": self.folder}

    @classmethod
    def unreadable(cls, name: str) -> Row:
        """Return a row in place of one that cannot be read, to report it among the others."""
        row = object.__new__(cls)
        task = next(iter(KINDS.values()))
        row.__dict__.update(name=name, options=(), folder=".", declared=task)
        return row

    def files(self) -> list[str]:
        """Return the absolute names of the files that it is made of, whether they exist or not."""
        return files_renamed(lambda rename: self._renamed(self._resolved(), rename))

    def moved(self, places: Mapping[str, str]) -> Row:
        """Return the same row with files, by their absolute names, elsewhere."""
        options = self._renamed(self._resolved(), lambda path: places.get(path, path))
        other = type(self)(self.name, options, self.folder, self.declared)
        other.__dict__.update(written=self.written, key=self.key)
        return other

    @cached_property
    def written(self) -> dict[str, Any]:
        """The options' values by column as they were written, which results tell of functions."""
        return self._values(self.options)

    def _resolved(self) -> list[tuple[str, str]]:
        return self._renamed(self.options, absolute(self.folder))

    def _renamed(self, options: Iterable[tuple[str, str]], rename: Rename) -> list[tuple[str, str]]:
        columns = _columns(self.declared)
        return [(column, columns[column].renamed(text, rename)) for column, text in options]

    def _values(self, options: Iterable[tuple[str, str]]) -> dict[str, Any]:
        columns, found = _columns(self.declared), dict[str, Any]()
        for column, text in options:
            value = columns[column].read(text)
            if columns[column].repeats:
                found.setdefault(column, []).append(value)
            else:
                found[column] = value
        return found


def problem_row(
    problem: Problem,
    folder: str | os.PathLike[str],
    name: str = "",
    max_distortion: float | None = None,
) -> Row:
    """Write a problem that was made in Python into the folder of results, once, and return its row.

    Raises
    ------
    ResultError
        If it cannot be written.
    """
    place = Path(PROBLEMS, f"{problem.digest}.npz")  # as the row has it, which begins at the folder
    path = Path(os.path.expanduser(folder), place)
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        problem.save(path)
    options = {"problem": place, "max-distortion": max_distortion}
    return Row(name or problem.digest[:8], options, folder)


@cache
def own_version() -> str:
    """Return the version of this abfm, which takes as long to find as to check a row."""
    return version("abfm")


@lru_cache
def _columns(task: type[Task]) -> dict[str, Input]:
    return by_name((*task.inputs, TASK))


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str | os.PathLike):
        return os.fspath(value).strip()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, tuple):
        return shlex.join(map(_text, value))
    raise ParameterError(f"{brief(value)} is neither text, path nor number")


def _content(path: str) -> str:
    """Return a name of what a file holds, and what it is made of besides."""
    sums = [_sum_of(each) for each in with_companions(path)]
    # readers go by suffixes
    return f"{hashlib.sha256(' '.join(sums).encode()).hexdigest()}{Path(path).suffix.lower()}"


def _sum_of(path: str) -> str:
    try:
        status = os.stat(path)
        return _sum(path, status.st_size, status.st_mtime_ns)
    except (OSError, ValueError):
        return f"missing {path}"


@lru_cache(maxsize=100_000)
def _sum(path: str, size: int, changed: int) -> str:
    """Return the checksum of a file as it was then."""
    found = hashlib.sha256()
    with open_plain(path) as file:
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def files_renamed(apply: Callable[[Rename], object]) -> list[str]:
    """Return the names that a function gives to the function that renames files, and those of files
    that their readers take besides.
    """
    found = dict[str, None]()

    def note(path: str) -> str:
        found.update(dict.fromkeys(with_companions(path)))
        return path

    apply(note)
    return list(found)


def with_companions(path: str) -> list[str]:
    """Return a file and those that its reader takes besides."""
    low = path.lower()
    if low.endswith(".sym.vts"):
        return [path, *(each for each in [f"{path[:-8]}.vts"] if os.path.exists(each))]
    if low.endswith(".gltf"):
        try:
            with open_plain(path, _LARGEST_JSON) as file:
                names = _URI.findall(file.read())
            decoded = (unquote(name.decode("utf-8", "replace")) for name in names)
            return [path, *(os.fspath(referenced_file(path, name)) for name in decoded)]
        except (OSError, ValueError):  # the reader reports them
            return [path]
    return list(dict.fromkeys([path, *files_of_frames(path)]))

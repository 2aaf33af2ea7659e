"""Rows: problems as paths and options, cheap to store, to send and to compare."""

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
from abfm.errors import ColumnError, ParameterError, brief, did_you_mean, printable
from abfm.matching.problem import Problem
from abfm.reading import open_regular, referenced_file
from abfm.sequences.reading.vtk_frames import files_of_frames
from abfm.tasks.inputs import Input, Rename, absolute, by_name
from abfm.tasks.task import Task

PROBLEMS = "problems"  # subfolder, in the folder of results, for problems created in Python
_BLOCK_BYTES = 1 << 20  # bytes read at once
_URI = re.compile(rb'"uri"\s*:\s*"((?!data:)[^"]{1,1000})"')
_GLTF_BYTES_MAX = 64 << 20  # size of a glTF file that may refer to other files


@dataclass(frozen=True)
class Row:
    """A problem as a row of a table. Files are read only when the problem is needed.

    Parameters
    ----------
    name : str
        Name of the row; unprintable characters become question marks.
    options : mapping of str, or pairs
        Texts by column. Columns have the names of the options of `abfm match` and `abfm register`:
        ``mesh``, ``source``, ``target``, ``alpha``, ...; ``a`` and ``b`` for a registration. Pairs
        may repeat ``channel``, also as a tuple of source, target and weight. Numbers and paths are
        converted to texts. None and empty texts count as not given.
    folder : path, optional
        Folder of relative paths; by default the current folder. If it is empty, paths stay
        unchanged.
    task : type, optional
        Type of the task. By default, the column ``task`` names the type, or the type follows from
        the other columns.

    Raises
    ------
    ParameterError
        If the columns fit no type of task, or a value is invalid.
    """

    name: str
    options: tuple[tuple[str, str], ...]
    folder: str
    task_type: type[Task]

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
                hint = did_you_mean(column, known)
                raise ColumnError(column, f" is not an option of the task '{kind}'{hint}")
            if column in seen and not known[column].repeats:
                raise ColumnError(column, " is given twice")
            seen.add(column)
            try:
                known[column].read(text)
            except ValueError as error:
                raise ColumnError(column, f": {error}") from None
        missing = [column for column in task.needs if column not in seen]
        if missing:
            raise ColumnError(missing[0], f" is empty, but the task '{kind}' requires it")
        folder = os.path.abspath(os.path.expanduser(folder)) if folder else ""
        title = printable(" ".join(str(name).split()))
        self.__dict__.update(name=title, options=given, folder=folder, task_type=task)
        self.task_type.check(self.values())

    @property
    def kind(self) -> str:
        """Name of the kind of task."""
        return self.task_type.kind

    def values(self) -> dict[str, Any]:
        """Return the parsed values by column; file names are absolute.

        Repeatable columns have lists of values.
        """
        return self._values(self._resolved())

    @cached_property
    def key(self) -> str:
        """Hash of the options and the contents of files, in hexadecimal digits.

        The key does not depend on where the files are. A missing file also has a key.
        """
        hashed_texts = [self.kind, installed_version()]
        columns = _columns(self.task_type)
        for column, text in sorted(self._resolved()):
            with_hashes = columns[column].renamed(text, _content)
            hashed_texts.append(f"{column} {columns[column].read(with_hashes)!r}")
        return hashlib.sha256(json.dumps(hashed_texts).encode()).hexdigest()

    @cached_property
    def digest(self) -> str:
        """Name of the result, in hexadecimal digits.

        For a match this is the digest of its `Problem`, so the files are read first. Raises an
        AbfmError if the inputs are invalid.
        """
        return self.task().digest

    def task(self) -> Task:
        """Read the files and return the task; raise an AbfmError if the inputs are invalid."""
        return self.task_type.read(self)

    def to_dict(self) -> dict[str, Any]:
        """Return name, options and folder as plain lists and texts."""
        return {"name": self.name, "options": list(map(list, self.options)), "folder": self.folder}

    @classmethod
    def unreadable(cls, name: str) -> Row:
        """Return a placeholder for a row that cannot be read, to report it among the others."""
        row = object.__new__(cls)
        task = next(iter(KINDS.values()))
        row.__dict__.update(name=name, options=(), folder=".", task_type=task)
        return row

    def files(self) -> list[str]:
        """Return the absolute names of all files of the row, whether they exist or not."""
        return files_renamed(lambda rename: self._renamed(self._resolved(), rename))

    def relocated(self, places: Mapping[str, str]) -> Row:
        """Return the row with moved files; ``places`` has new paths by absolute file name."""
        options = self._renamed(self._resolved(), lambda path: places.get(path, path))
        other = type(self)(self.name, options, self.folder, self.task_type)
        other.__dict__.update(written=self.written, key=self.key)
        return other

    @cached_property
    def written(self) -> dict[str, Any]:
        """Values by column, with file names as the user wrote them; results store these texts."""
        return self._values(self.options)

    def _resolved(self) -> list[tuple[str, str]]:
        return self._renamed(self.options, absolute(self.folder))

    def _renamed(self, options: Iterable[tuple[str, str]], rename: Rename) -> list[tuple[str, str]]:
        columns = _columns(self.task_type)
        return [(column, columns[column].renamed(text, rename)) for column, text in options]

    def _values(self, options: Iterable[tuple[str, str]]) -> dict[str, Any]:
        columns, found = _columns(self.task_type), dict[str, Any]()
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
    """Return the row of a problem created in Python; write its file to the folder if it is missing.

    Raises
    ------
    ResultError
        If the problem cannot be written.
    """
    place = Path(PROBLEMS, f"{problem.digest}.npz")  # relative to the folder, as in the row
    path = Path(os.path.expanduser(folder), place)
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        problem.save(path)
    options = {"problem": place, "max-distortion": max_distortion}
    return Row(name or problem.digest[:8], options, folder)


@cache
def installed_version() -> str:
    """Return the installed version of abfm; cached, as the query is as slow as checking a row."""
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
    raise ParameterError(f"the value is {brief(value)}; expected a text, a path or a number")


def _content(path: str) -> str:
    """Return the hash of a file and of the files that it refers to, with the suffix of the file."""
    sums = [_checksum_of(each) for each in with_companions(path)]
    # readers are chosen by suffix
    return f"{hashlib.sha256(' '.join(sums).encode()).hexdigest()}{Path(path).suffix.lower()}"


def _checksum_of(path: str) -> str:
    try:
        status = os.stat(path)
        return _checksum(path, status.st_size, status.st_mtime_ns)
    except (OSError, ValueError):
        return f"missing {path}"


@lru_cache(maxsize=100_000)
def _checksum(path: str, size: int, changed: int) -> str:
    """Return the checksum of a file, cached until its size or time of change differs."""
    found = hashlib.sha256()
    with open_regular(path) as file:
        while block := file.read(_BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def files_renamed(apply: Callable[[Rename], object]) -> list[str]:
    """Return the file names that ``apply`` passes to its argument, and their companion files."""
    found = dict[str, None]()

    def note(path: str) -> str:
        found.update(dict.fromkeys(with_companions(path)))
        return path

    apply(note)
    return list(found)


def with_companions(path: str) -> list[str]:
    """Return a file and its companions, the files that its reader also opens."""
    low = path.lower()
    if low.endswith(".sym.vts"):
        return [path, *(each for each in [f"{path[:-8]}.vts"] if os.path.exists(each))]
    if low.endswith(".gltf"):
        try:
            with open_regular(path, _GLTF_BYTES_MAX) as file:
                names = _URI.findall(file.read())
            decoded = (unquote(name.decode("utf-8", "replace")) for name in names)
            return [path, *(os.fspath(referenced_file(path, name)) for name in decoded)]
        except (OSError, ValueError):  # the reader reports the error
            return [path]
    return list(dict.fromkeys([path, *files_of_frames(path)]))

"""What cells of a table hold: how a text becomes a value, and which files it names."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from abfm.errors import FunctionError, ParameterError, brief
from abfm.functions import Circular, Permuted, Scaled, Spec, Sum, ValuesFile, parse, quoted
from abfm.functions.circular import checked_period
from abfm.matching.bounded import check_bound
from abfm.mesh.options import MeshOptions, read_flag
from abfm.parameters import FIELDS, option
from abfm.reading.parameters import hint, parameter_reader
from abfm.reading.text_tables import parse_number
from abfm.registration import initial

Rename = Callable[[str], str]
"""What to call a file that a cell names."""


class Column(NamedTuple):
    """What the cells of a column hold."""

    about: str
    read: Callable[[str], Any] = str
    """Turn a text into a value, or raise an AbfmError."""
    renamed: Callable[[str, Rename], str] = lambda text, rename: text
    """Turn a text into the same with other names of files."""
    repeats: bool = False
    """Whether a table may have it several times."""


def parameter_columns(chosen: Collection[str] = ()) -> dict[str, Column]:
    """Return a column for each of `abfm.Parameters`, named as the options are; "auto" is also
    accepted for those that are chosen by default.
    """
    return {
        option(name): Column(entry.metadata["help"], parameter_reader(name, chosen))
        for name, entry in FIELDS.items()
    }


def parameters_in(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those values that are of `abfm.Parameters`, by their names there."""
    names = {option(name): name for name in FIELDS}
    return {names[column]: value for column, value in values.items() if column in names}


def _bound(text: str) -> float:
    try:
        bound = parse_number(text)
    except ValueError:
        raise ParameterError(f"{brief(text)} is no number{hint(text)}") from None
    check_bound(bound)
    return bound


def _circular(text: str) -> bool | float:
    try:
        period: float = parse_number(text)
    except ValueError:
        return read_flag(text)
    return period if checked_period(period) is not None else False


@lru_cache(maxsize=1000)  # many rows of a table have the same functions
def _spec(text: str) -> str:
    parse(text)
    return text


def _renamed_spec(text: str, rename: Rename) -> str:
    renamed = _with_files(parse(text), rename)
    return text if renamed == parse(text) else str(renamed)


def _with_files(spec: Spec, rename: Rename) -> Spec:
    if isinstance(spec, Sum):
        return Sum(tuple(_with_files(term, rename) for term in spec.terms))
    if isinstance(spec, ValuesFile):
        return replace(spec, path=rename(spec.path))
    if isinstance(spec, Scaled | Circular):
        return replace(spec, function=_with_files(spec.function, rename))
    if isinstance(spec, Permuted):
        path = spec.path if spec.is_detected or "." not in spec.path else rename(spec.path)
        return replace(spec, path=path, function=_with_files(spec.function, rename))
    return spec


def _renamed_weight(text: str, rename: Rename) -> str:
    """Rename in a function, or in the name of a file, which is no function."""
    try:
        parse(text)
    except FunctionError:
        return f"file:{quoted(rename(text))}"
    return _renamed_spec(text, rename)


def _channel(text: str) -> tuple[str, str, float]:
    try:
        source, target, weight = shlex.split(text)
        return _spec(source), _spec(target), parse_number(weight)
    except ValueError as error:
        if isinstance(error, FunctionError):
            raise
        raise ParameterError(
            f"{brief(text)} is no channel: expected source, target and weight with blanks between"
        ) from None


def _renamed_channel(text: str, rename: Rename) -> str:
    source, target, weight = _channel(text)
    return shlex.join((_renamed_spec(source, rename), _renamed_spec(target, rename), repr(weight)))


def _initial(text: str) -> str:
    initial.word_of(text)
    return text


def _renamed_initial(text: str, rename: Rename) -> str:
    """Rename in ``file:MAP`` and ``sphere:mirror,A,B``."""
    name, _, rest = text.partition(":")
    if name not in ("file", "sphere") or not rest:
        return text
    if name == "file":
        return f"file:{rename(rest)}"
    words = [word.strip() for word in rest.split(",")]
    return f"sphere:{','.join(word if word == 'mirror' else rename(word) for word in words)}"


def _file(text: str, rename: Rename) -> str:
    return rename(text)


SPEC = Column("a function as text", _spec, _renamed_spec)
FILE = Column("a file", str, _file)
WEIGHT = Column("weight at each vertex: a function, or its file", str, _renamed_weight)
CHANNEL = Column("source, target and weight, with blanks between", _channel, _renamed_channel, True)
INITIAL = Column("the initial map, by its word", _initial, _renamed_initial)
CIRCULAR = Column("whether values are phases, or their period", _circular)
ONE_BASED = Column("whether landmarks count vertices from 1", read_flag)
BOUND = Column("the most that areas and shapes may change", _bound)
MESH_OPTIONS = {
    option(entry.name): Column(entry.metadata["help"], partial(MeshOptions.value, entry.name))
    for entry in fields(MeshOptions)
}
"""How the meshes of a row are read."""


def mesh_options(values: Mapping[str, Any]) -> MeshOptions:
    """Return the options of reading meshes that are among values by column."""
    found = {name.replace("-", "_"): values[name] for name in MESH_OPTIONS if name in values}
    return MeshOptions(**found)


def absolute(folder: str) -> Rename:
    """Return what makes names of files absolute which begin at a folder."""
    return lambda path: os.fspath(Path(folder, Path(os.path.expanduser(path))))

"""Inputs of tasks: their parsers, the files that they name, and their help."""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from abfm.errors import FunctionError, ParameterError, brief
from abfm.functions import Permuted, Spec, Sum, ValuesFile, Wrapper, parse, quoted
from abfm.functions.circular import checked_period
from abfm.functions.circular_channels import split_channels
from abfm.mesh.options import MERGE, MeshOptions, read_flag
from abfm.parameters import CHOICES, FIELDS, MAIN_FIELDS, Parameters, checked, is_integer, option
from abfm.reading.text_tables import parse_number

MESH_FORMATS = (
    "triangle mesh: obj, off, ply, stl, glb, gltf, gii, vtk, vtp, vtu, FreeSurfer or MNI; also "
    "compressed (.gz)"
)
PARAMETERS = "parameters (in brackets: symbol in the paper)"
"""Heading of the parameters of a match in ``--help``."""
SPEC_HELP = """\
SPEC is a file of values (lh.sulc, values.npy) or family:key=value,...; several are added with +.
Common families: gaussian, eigenfunction, hks, curvature, coordinate, expression.
"""
FUNCTIONS_HELP = """\
Functions (SPEC):
  values.npy, lh.sulc             one value per vertex; the same as file:values.npy
  gaussian:vertex=12,width=0.1    bump around a vertex, or around x=,y=,z=
  eigenfunction:7                 eigenfunction of the Laplacian; 0 is the constant
  hks:time=0.01                   heat kernel signature
  wks:energy=5                    wave kernel signature
  curvature:mean                  mean or gaussian curvature
  coordinate:x                    coordinate x, y or z
  geodesic:vertex=12              distance along the surface to a vertex
  shape-diameter                  thickness of the body
  indicator:vertex=12,radius=0.2  1 in a geodesic disc or a half-space (axis=z,above=0), 0 elsewhere
  expression:sin(10*x)*z          formula in x, y and z
  permuted:mirror(SPEC)           a function composed with mirror, rotation, or a map from a file
  scaled:2,offset=1(SPEC)         a function times a factor, plus an offset
  smoothed:0.05(SPEC)             a function smoothed over a length
  circular:period=360(SPEC)       cosine and sine of phases
Vertices are counted from 0, as in the mesh file. Widths, radii and times refer to the mesh scaled
to unit area. A mask (--mask, --mask-a, --mask-b) is a weight of each vertex.
"""
CHANNELS_HELP = """\
Channels:
  A channel is a source, a target and the weight of their mismatch; --source and --target are a
  channel of weight 1. All channels have the same flow.
"""
_CHANNEL = "SRC DST WEIGHT"
Rename = Callable[[str], str]  # a function that returns another name for a file


def parameter_reader(name: str, is_optional: bool) -> Callable[[str], Any]:
    """Return a parser of the values of a parameter; an optional one reads "auto" as None."""
    entry = FIELDS[name]
    noun = f"{'an integer' if is_integer(entry) else 'a number'}{' or auto' * is_optional}"

    @lru_cache(maxsize=1000)  # most cells of a column are equal
    def read(text: str) -> Any:
        value: Any = text
        if is_optional and text == "auto":
            return None
        if name not in CHOICES:
            try:
                value = int(text) if is_integer(entry) else parse_number(text)
            except ValueError:
                raise ParameterError(f"{brief(text)} is not {noun}{hint(text)}") from None
        return checked(entry, value)

    return read


def hint(text: str) -> str:
    return "; use a decimal point and no thousands separators" if "," in text else ""


@dataclass(frozen=True, kw_only=True)
class Input:
    """An input of a task: a column of tables, and an option of the task's command."""

    name: str  # name of the column, and of the option after ``--``
    help: str  # text for ``--help``, one line
    read: Callable[[str], Any] = str  # parses a text and returns its value, or raises an AbfmError
    # name of the value in ``--help``, one word for each value; empty for a flag, whose text is
    # "yes"
    metavar: str = ""
    group: str = ""  # heading of its group in ``--help``
    default: str = ""  # default value as shown in ``--help``; empty if none is shown
    without_value: str = ""  # text of an option without a value; empty if it needs a value
    # replaces the file names in a text
    renamed: Callable[[str, Rename], str] = lambda text, rename: text
    repeats: bool = False  # whether the option can be repeated
    is_argument: bool = False  # whether the command accepts it as a positional argument
    is_rare: bool = False  # whether the command accepts it only as ``--set NAME=VALUE``


def by_name(inputs: Iterable[Input]) -> dict[str, Input]:
    return {each.name: each for each in inputs}


def parameter_inputs(
    defaults: Mapping[str, Any] | None = None, help: Mapping[str, str] | None = None
) -> tuple[Input, ...]:
    """Return one input for each parameter of a match.

    ``defaults`` has the defaults by name; the solver chooses a default that is None, written
    "auto". ``help`` has texts by name that replace the usual help.
    """
    inputs = []
    for name, value in (defaults or Parameters().to_dict()).items():
        entry, choices = FIELDS[name], CHOICES.get(name)
        text = (help or {}).get(name, entry.metadata["help"])
        if value is not None:
            text = text.partition("; auto:")[0]
        symbol = f" [{letter}]" if (letter := entry.metadata["symbol"].strip("*")) else ""
        number = "INT" if is_integer(entry) else "X"
        inputs.append(
            Input(
                name=option(name),
                help=f"{text}{symbol}",
                read=parameter_reader(name, None in (value, entry.default)),
                metavar=f"{{{','.join(choices)}}}" if choices else number,
                group=PARAMETERS,
                default="auto" if value is None else str(value),
                is_rare=name not in MAIN_FIELDS,
            )
        )
    return tuple(inputs)


def parameters_in(values: Mapping[str, Any]) -> dict[str, Any]:
    """Select the values of parameters of a match, and return them by name in `Parameters`."""
    names = {option(name): name for name in FIELDS}
    return {names[column]: value for column, value in values.items() if column in names}


def number_input(
    name: str,
    help: str,
    metavar: str,
    expected: str,
    is_valid: Callable[[float], bool],
    **settings: Any,
) -> Input:
    """Return an input that accepts finite numbers for which ``is_valid`` returns True.

    ``expected`` describes such a number in messages, for example "above 0".
    """
    read = partial(read_number, expected=expected, is_valid=is_valid)
    return Input(name=name, help=help, read=read, metavar=metavar, **settings)


def read_number(text: str, expected: str, is_valid: Callable[[float], bool]) -> float:
    """Parse a finite number for which ``is_valid`` returns True; see `number_input`."""
    try:
        number: float = parse_number(text)
    except ValueError:
        raise ParameterError(f"{brief(text)} is not a number{hint(text)}") from None
    if not (math.isfinite(number) and is_valid(number)):
        raise ParameterError(f"{brief(text)} is not a number {expected}")
    return number


def _circular(text: str) -> bool | float:
    try:
        period: float = parse_number(text)
    except ValueError:
        return read_flag(text)
    return period if checked_period(period) is not None else False


@lru_cache(maxsize=1000)  # rows of a table share functions
def read_function(text: str) -> str:
    """Return the function specification of a text, which may also be the name of a file."""
    try:
        parse(text)
    except FunctionError:
        if not _is_file_name(text, text):
            raise
        return f"file:{quoted(text)}"
    return text


def _is_file_name(text: str, path: str) -> bool:
    """Return whether a text that is not a specification is the name of a file.

    Either the file ``path`` exists, or the text has a suffix and no colon.
    """
    without_drive = os.path.splitdrive(text)[1]
    return os.path.exists(path) or (bool(Path(text).suffix) and ":" not in without_drive)


def renamed_spec(text: str, rename: Rename) -> str:
    renamed = _with_files(parse(text), rename)
    return text if renamed == parse(text) else str(renamed)


def _with_files(spec: Spec, rename: Rename) -> Spec:
    if isinstance(spec, Sum):
        return Sum(tuple(_with_files(term, rename) for term in spec.terms))
    if isinstance(spec, ValuesFile):
        return replace(spec, path=rename(spec.path))
    if isinstance(spec, Permuted) and not spec.is_detected and "." in spec.path:
        spec = replace(spec, path=rename(spec.path))
    if isinstance(spec, Wrapper):
        return replace(spec, function=_with_files(spec.function, rename))
    return spec


def renamed_function(text: str, rename: Rename) -> str:
    """Convert a text as `read_function` does, and replace its file names by ``rename``."""
    try:
        parse(text)
    except FunctionError:
        if not _is_file_name(text, rename(text)):
            raise
        return f"file:{quoted(rename(text))}"
    return renamed_spec(text, rename)


def channel_words(text: str, metavar: str) -> list[str]:
    """Split the text of a channel into as many words as ``metavar`` has."""
    try:
        words = _split(text)
    except ValueError:
        words = []
    if len(words) != len(metavar.split()):
        raise ParameterError(
            f"{brief(text)} is not a channel; expected {metavar}, separated by spaces"
        )
    return words


def _split(text: str) -> list[str]:
    """Split a text into words as a shell does; on Windows, a backslash is not an escape sign."""
    words = shlex.shlex(text, posix=True, punctuation_chars=False)
    words.whitespace_split, words.commenters = True, ""
    if sys.platform == "win32":
        words.escape = ""
    return list(words)


def _channel(text: str) -> tuple[str, str, float]:
    source, target, weight = channel_words(text, _CHANNEL)
    return read_function(source), read_function(target), channel_weight(weight)


def channel_weight(text: str) -> float:
    try:
        return float(parse_number(text))
    except ValueError:
        raise ParameterError(f"{brief(text)} is not a weight; expected a number") from None


def _renamed_channel(text: str, rename: Rename) -> str:
    source, target, weight = channel_words(text, _CHANNEL)
    functions = (renamed_function(text, rename) for text in (source, target))
    return shlex.join((*functions, repr(channel_weight(weight))))


def _renamed_file(text: str, rename: Rename) -> str:
    return rename(text)


def file_input(name: str, help: str, metavar: str = "FILE", **settings: Any) -> Input:
    return Input(name=name, help=help, metavar=metavar, renamed=_renamed_file, **settings)


def function_input(name: str, help: str) -> Input:
    return Input(
        name=name,
        help=help,
        read=read_function,
        metavar="SPEC",
        group="functions",
        renamed=renamed_function,
    )


def mask_input(name: str, help: str) -> Input:
    """Return the input of a mask: a nonnegative weight at each vertex."""
    text = f"{help}, 0 or more: a file of values or a SPEC (default: 1)"
    return Input(name=name, help=text, metavar="FILE", group="functions", renamed=renamed_function)


CIRCULAR_INPUT = Input(
    name="circular",
    help="values are phases with this period (2 pi if it is omitted), compared by cosine and sine",
    read=_circular,
    metavar="PERIOD",
    group="functions",
    without_value="yes",
)


def channel_input(
    help: str,
    metavar: str,
    read: Callable[[str], Any],
    renamed: Callable[[str, Rename], str] = lambda text, rename: text,
) -> Input:
    """Return the input of a channel, whose last word is its weight."""
    return Input(
        name="channel",
        help=help,
        read=read,
        metavar=metavar,
        group="functions",
        renamed=renamed,
        repeats=True,
    )


def channel_inputs(source: str, target: str) -> tuple[Input, ...]:
    """Return the inputs that `channels` uses; ``source`` and ``target`` are their help texts."""
    further = "further source and target for the same flow, and the weight of their mismatch"
    return (
        function_input("source", source),
        function_input("target", target),
        channel_input(further, _CHANNEL, _channel, _renamed_channel),
        CIRCULAR_INPUT,
    )


def channels(values: Mapping[str, Any]) -> tuple[list[str], list[str], list[float]]:
    """Return the sources, targets and weights of C channels, (C,) each, from the inputs' values.

    A phase becomes two channels. Raises ParameterError if source or target is given alone.
    """
    if ("source" in values) != ("target" in values):
        raise ParameterError("source and target must be given together")
    first = [(values["source"], values["target"], 1.0)] if "source" in values else []
    found = [*first, *values.get("channel", ())]
    sources, targets, weights = ([each[part] for each in found] for part in range(3))
    period = checked_period(values.get("circular", False))
    return split_channels(sources, targets, weights, period)


MESH_INPUTS = tuple(
    Input(
        name=option(entry.name),
        help=entry.metadata["help"],
        read=partial(MeshOptions.value, entry.name),
        metavar=entry.metadata["metavar"],
        group="meshes",
        without_value="auto" if entry.name == MERGE else "",
    )
    for entry in fields(MeshOptions)
)
"""Inputs that control how the meshes of a task are loaded."""


def mesh_options(values: Mapping[str, Any]) -> MeshOptions:
    names = {option(entry.name): entry.name for entry in fields(MeshOptions)}
    return MeshOptions(**{names[name]: values[name] for name in names if name in values})


def absolute(folder: str) -> Rename:
    """Return a function that makes file names absolute, relative to a folder."""
    return lambda path: os.fspath(Path(folder, Path(os.path.expanduser(path))))

"""The kinds of rows that a table may have: here is where one is declared."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from abfm.batch import columns
from abfm.batch.columns import Column, parameter_columns
from abfm.batch.kind import Kind
from abfm.batch.matches import check_match, prepare_match, prepare_problem
from abfm.batch.registrations import check_registration, prepare_registration
from abfm.batch.sequences import (
    check_sequence,
    facts_of_sequence,
    not_negative,
    positive,
    prepare_sequence,
    weights,
)
from abfm.errors import ParameterError
from abfm.matching import load_match
from abfm.parameters import option
from abfm.registration import load_registration
from abfm.sequences import CHOSEN, TAKEN, load_sequence

_FUNCTIONS: Mapping[str, Column] = {
    "source": columns.SPEC,
    "target": columns.SPEC,
    "channel": columns.CHANNEL,
    "circular": columns.CIRCULAR,
}
_ANY: Mapping[str, Column] = {
    **columns.MESH_OPTIONS,
    "max-distortion": columns.BOUND,
    **parameter_columns(),
}
KINDS: Mapping[str, Kind] = {
    "sequence": Kind(
        ("frames", "mesh"),
        {
            "mesh": columns.FILE,
            "frames": columns.FILE,
            "array": Column("the name of the values in files that hold several"),
            "dt": Column("time between two frames", positive),
            "gamma": Column("how much neighbouring fields are held together", not_negative),
            "mask": columns.WEIGHT,
            "circular": columns.CIRCULAR,
            "weights": Column("weight of each channel, with commas or blanks between", weights),
            **columns.MESH_OPTIONS,
            **{option(name): parameter_columns(CHOSEN)[option(name)] for name in TAKEN},
        },
        prepare_sequence,
        load_sequence,
        facts_of_sequence,
        check_sequence,
    ),
    "match": Kind(
        ("mesh",),
        {"mesh": columns.FILE, **_FUNCTIONS, "mask": columns.WEIGHT, "start": columns.FILE, **_ANY},
        prepare_match,
        load_match,
        check=check_match,
    ),
    "registration": Kind(
        ("a", "b"),
        {
            "a": columns.FILE,
            "b": columns.FILE,
            **_FUNCTIONS,
            "mask-a": columns.WEIGHT,
            "mask-b": columns.WEIGHT,
            "landmarks": columns.FILE,
            "one-based": columns.ONE_BASED,
            "initial": columns.INITIAL,
            **_ANY,
        },
        prepare_registration,
        load_registration,
        check=check_registration,
    ),
    "problem": Kind(
        ("problem",),
        {"problem": columns.FILE, "max-distortion": columns.BOUND},
        prepare_problem,
        load_match,
        check=lambda values: None,
    ),
}
"""All kinds of rows, by name; a row is of the first whose first needed column it fills."""


def kind_of_columns(given: Collection[str], kinds: Mapping[str, Kind] = KINDS) -> str:
    """Return the kind of row that fills such columns, or raise a ParameterError."""
    for name, kind in kinds.items():
        if kind.needs[0] in given:
            return name
    ways = ", or ".join(f"{' and '.join(kind.needs)} ({name})" for name, kind in kinds.items())
    raise ParameterError(f"it is of no kind: fill {ways}")

"""Parameters of a sequence: those of a match that it takes, and which of them it chooses."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from abfm.errors import ParameterError, brief
from abfm.parameters import FIELDS, Parameters

DEFAULTS: dict[str, Any] = {
    "alpha": 1.0,
    "order": 1,
    "divergence": 1.0,
    "reach": 0.0,
    "levels": 1,
    "refine": 0,
    "segments": 1,
}
"""Parameters whose defaults differ from those of a match."""
TAKEN = ("alpha", "beta", "divergence", "order", "sigma", "sigma_unit", "goal")
"""Parameters that may be given."""
CHOSEN = ("alpha", "order")
"""Parameters of the norm of fields, which are chosen unless they are given; so is sigma."""


@dataclass(frozen=True)
class SequenceParameters(Parameters):
    """Parameters of a sequence, see `defaults`.

    Attributes
    ----------
    automatic : tuple of str
        Which of ``alpha`` and ``order`` are chosen by held-out data. In a `Sequence` they have the
        chosen values.
    """

    automatic: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = [name for name in self.automatic if name not in CHOSEN]
        if unknown:
            raise ParameterError(
                f"{brief(unknown[0])} cannot be automatic; expected names among {', '.join(CHOSEN)}"
            )
        object.__setattr__(self, "automatic", tuple(n for n in CHOSEN if n in self.automatic))

    def of_match(self, **changes: Any) -> Parameters:
        """Return the parameters of an ordinary match, with changes."""
        own = {entry.name: getattr(self, entry.name) for entry in fields(Parameters)}
        return Parameters(**own).with_values(**changes)


def defaults(**changes: Any) -> SequenceParameters:
    """Return the parameters of a sequence, with changes of those in `TAKEN`.

    ``alpha``, ``order`` and ``sigma`` are chosen by held-out data where they are None or not given.

    Raises
    ------
    ParameterError
        If another one is given, or a value is out of range.
    """
    unknown = sorted(changes.keys() - set(TAKEN))
    if unknown:
        raise ParameterError(
            f"a sequence does not take {brief(unknown[0])}; expected one of {', '.join(TAKEN)}"
        )
    automatic = tuple(name for name in CHOSEN if changes.get(name) is None)
    given = {name: value for name, value in changes.items() if name not in automatic}
    return SequenceParameters.of(**DEFAULTS | given, automatic=automatic)


def checked_parameters(parameters: Parameters | None) -> SequenceParameters:
    """Return the parameters of a sequence; those of a match are kept as they are given.

    Raises
    ------
    ParameterError
        If one is changed that sequences do not take.
    """
    if parameters is None:
        return defaults()
    usual, of_match = Parameters.of(**DEFAULTS).to_dict(), Parameters().to_dict()
    given = parameters.to_dict()
    for name, value in given.items():
        if name in FIELDS and name not in TAKEN and value not in (usual[name], of_match[name]):
            raise ParameterError(
                f"a sequence does not take {name}; expected changes of {', '.join(TAKEN)} alone, "
                "see abfm.sequences.defaults"
            )
    taken = {name: given[name] for name in TAKEN}
    automatic = parameters.automatic if isinstance(parameters, SequenceParameters) else ()
    return SequenceParameters.of(**DEFAULTS | taken, automatic=automatic)

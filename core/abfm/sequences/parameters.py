"""Parameters of a sequence, including those that held-out data choose."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

from abfm.errors import ParameterError, brief
from abfm.parameters import FIELDS, Parameters, Settings

AUTOMATIC_NAMES = ("alpha", "order")
"""Parameters of the norm of fields that held-out data choose, like sigma, if they are not given."""


@dataclass(frozen=True)
class SequenceParameters(Settings):
    """Parameters of a sequence, as in `abfm.Parameters`; see `defaults`.

    Attributes
    ----------
    automatic : tuple of str
        Names of the parameters, ``alpha`` or ``order``, that held-out data choose. In a `Sequence`
        these parameters have the chosen values.
    """

    alpha: float = 1.0
    beta: float = 0.0
    divergence: float | None = 1.0
    order: int = 1
    sigma: float | None = None
    sigma_unit: Literal["relative", "absolute"] = "relative"
    goal: float = 0.05
    automatic: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = [name for name in self.automatic if name not in AUTOMATIC_NAMES]
        if unknown:
            raise ParameterError(
                f"{brief(unknown[0])} cannot be automatic; expected {' or '.join(AUTOMATIC_NAMES)}"
            )
        object.__setattr__(
            self, "automatic", tuple(n for n in AUTOMATIC_NAMES if n in self.automatic)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by name as plain values."""
        return asdict(self)

    def for_interval(self, duration: float, sigma: float) -> Parameters:
        """Return the parameters of the match of one interval, with an absolute sigma."""
        values = {name: getattr(self, name) for name in PARAMETER_NAMES}
        values |= {"tau": duration, "sigma": sigma, "sigma_unit": "absolute"}
        return Parameters.of(**values, reach=0.0, levels=1, refine=0, segments=1)


PARAMETER_NAMES = tuple(each.name for each in fields(SequenceParameters) if each.name in FIELDS)
"""Names of the parameters that users may give."""


def defaults(
    alpha: float | None = None, order: int | None = None, **others: Any
) -> SequenceParameters:
    """Return the default parameters of a sequence, with some values replaced by the arguments.

    Held-out data choose ``alpha``, ``order`` and ``sigma`` if these are None or not given.

    Raises
    ------
    ParameterError
        If a value is out of range.
    """
    norm = {"alpha": alpha, "order": order}
    others |= {name: value for name, value in norm.items() if value is not None}
    automatic = tuple(name for name in norm if name not in others)
    return SequenceParameters(**others, automatic=automatic)


def checked_parameters(parameters: SequenceParameters | None) -> SequenceParameters:
    if not isinstance(parameters, SequenceParameters | None):
        raise ParameterError(
            f"parameters is {brief(parameters)}; expected abfm.sequences.defaults(...)"
        )
    return parameters or defaults()

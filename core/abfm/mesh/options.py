"""Options of reading a mesh: what to change before it is checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypedDict

from abfm.errors import ParameterError, brief
from abfm.reading import HEMISPHERES

_TRUE_WORDS = ("yes", "true", "1")
_FALSE_WORDS = ("no", "false", "0")
MERGE = "merge"


class MeshKeywords(TypedDict, total=False):
    """The options as keywords of functions."""

    merge: bool | float | None
    clean: bool
    hemisphere: str | None
    largest_component: bool


def read_flag(text: str) -> bool:
    """Return True for a text such as "yes", False for one such as "no"."""
    if text.lower() in (*_TRUE_WORDS, *_FALSE_WORDS):
        return text.lower() in _TRUE_WORDS
    raise ParameterError(f"{brief(text)} is neither {_TRUE_WORDS[0]} nor {_FALSE_WORDS[0]}")


def read_merge(text: str) -> bool | float:
    """Return the distance that a text gives, or True for ``auto``."""
    if text.lower() in ("auto", "yes", "true"):
        return True
    if text.lower() in ("no", "false"):
        return False
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"{brief(text)} is neither a distance nor auto") from None


def _option(read: Callable[[str], Any], metavar: str, button: str, about: str, default: Any) -> Any:
    metadata = {"read": read, "metavar": metavar, "button": button, "help": about}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """What to change in a mesh before it is checked, in this order.

    The metadata of each field has its ``help``, the ``metavar`` of its value (empty for a flag),
    what its ``button`` is called, and ``read``, which makes its value of a text.

    Raises
    ------
    ParameterError
        If the distance is not a positive number, or the hemisphere neither L nor R.
    """

    merge: bool | float | None = _option(
        read_merge,
        "DISTANCE",
        "Merge vertices",
        "merge vertices at most DISTANCE apart, in the file's unit; without it, those at the same "
        "position and up to 1e-6 of the diagonal of the bounding box",
        None,
    )
    clean: bool = _option(
        read_flag,
        "",
        "Clean",
        "remove repeated faces, faces without area, and sheets that hang on the surface",
        False,
    )
    hemisphere: str | None = _option(
        str,
        "L|R",
        "",
        "use the left or right hemisphere of a surface with both; L has the smaller x, or is the "
        "first in the file if both are at one place",
        None,
    )
    largest_component: bool = _option(
        read_flag,
        "",
        "Largest component",
        "of several components use the one with the largest area",
        False,
    )

    def __post_init__(self) -> None:
        merge, side = self.merge, self.hemisphere
        is_distance = isinstance(merge, int | float) and math.isfinite(merge) and merge > 0
        if not (merge is None or isinstance(merge, bool) or is_distance):
            raise ParameterError(
                f"merge is {brief(merge)}; expected a distance above 0, or True for one that is "
                "chosen from the size of the mesh"
            )
        if side is not None and side not in HEMISPHERES:
            raise ParameterError(f"hemisphere is {brief(side)}; expected L or R")

    @classmethod
    def value(cls, name: str, text: str) -> Any:
        """Return the value of an option that a text gives, or raise a ParameterError."""
        read = next(each.metadata["read"] for each in fields(cls) if each.name == name)
        value: Any = read(text)
        cls(**{name: value})
        return value

    @property
    def given(self) -> Mapping[str, Any]:
        """The options that are not the defaults, by name."""
        values = ((each.name, getattr(self, each.name)) for each in fields(self))
        return {name: value for name, value in values if value}

    @property
    def words(self) -> str:
        """The options as on the command line."""
        return " ".join(
            f"--{name.replace('_', '-')}{'' if value is True else f' {value}'}"
            for name, value in self.given.items()
        )

    @property
    def keywords(self) -> str:
        """The options as in Python."""
        return ", ".join(f"{name}={value!r}" for name, value in self.given.items())

    @property
    def button(self) -> str:
        """What a button is called that applies the options."""
        buttons = {each.name: each.metadata["button"] for each in fields(self)}
        names = [buttons[name] or HEMISPHERES[value].title() for name, value in self.given.items()]
        return ", ".join([names[0], *(name.lower() for name in names[1:])])


DEFAULT_OPTIONS = MeshOptions()
"""Nothing is changed."""

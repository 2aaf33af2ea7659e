"""Options for loading a mesh: changes made before it is checked."""

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
    merge: bool | float | None
    clean: bool
    hemisphere: str | None
    largest_component: bool


def read_flag(text: str) -> bool:
    """Return True for a text such as "yes" and False for one such as "no"."""
    if text.lower() in (*_TRUE_WORDS, *_FALSE_WORDS):
        return text.lower() in _TRUE_WORDS
    raise ParameterError(f"{brief(text)} is not {_TRUE_WORDS[0]} or {_FALSE_WORDS[0]}")


def read_merge(text: str) -> bool | float:
    """Convert text to a merging distance, or to True ("auto", "yes") or False ("no")."""
    if text.lower() in ("auto", "yes", "true"):
        return True
    if text.lower() in ("no", "false"):
        return False
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"{brief(text)} is not a distance, auto, yes or no") from None


def _option(read: Callable[[str], Any], metavar: str, button: str, about: str, default: Any) -> Any:
    metadata = {"read": read, "metavar": metavar, "button": button, "help": about}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """Changes to a mesh before it is checked, in the order in which they apply.

    The metadata of each field has its ``help``, the label of its ``button``, and the ``metavar`` of
    its value (empty for a flag). The function ``read`` in it converts text to the value. Raises
    ParameterError if the distance is not a positive number, or the hemisphere is neither L nor R.
    """

    merge: bool | float | None = _option(
        read_merge,
        "DISTANCE",
        "Merge vertices",
        "merge vertices at most DISTANCE apart, in the unit of the file; without DISTANCE, at most "
        "1e-6 of the diagonal of the bounding box",
        None,
    )
    clean: bool = _option(
        read_flag,
        "",
        "Clean",
        "remove repeated faces, faces without area, and sheets joined along edges of three faces",
        False,
    )
    hemisphere: str | None = _option(
        str,
        "L|R",
        "",
        "use only one hemisphere of a surface with both; L is the one with smaller x, or the "
        "first in the file if they overlap",
        None,
    )
    largest_component: bool = _option(
        read_flag, "", "Largest component", "use only the component with the largest area", False
    )

    def __post_init__(self) -> None:
        merge, side = self.merge, self.hemisphere
        is_distance = isinstance(merge, int | float) and math.isfinite(merge) and merge > 0
        if not (merge is None or isinstance(merge, bool) or is_distance):
            raise ParameterError(
                f"merge is {brief(merge)}; expected a distance above 0, or True for a distance "
                "chosen from the size of the mesh"
            )
        if side is not None and side not in HEMISPHERES:
            raise ParameterError(f"hemisphere is {brief(side)}; expected L or R")

    @classmethod
    def value(cls, name: str, text: str) -> Any:
        """Convert text to the value of the option with this name, or raise a ParameterError."""
        read = next(each.metadata["read"] for each in fields(cls) if each.name == name)
        value: Any = read(text)
        cls(**{name: value})
        return value

    @property
    def changed(self) -> Mapping[str, Any]:
        """The options that differ from the defaults, as a mapping from names to values."""
        values = ((each.name, getattr(self, each.name)) for each in fields(self))
        return {name: value for name, value in values if value}

    @property
    def arguments(self) -> str:
        """The options as arguments of the command line."""
        return " ".join(
            f"--{name.replace('_', '-')}{'' if value is True else f' {value}'}"
            for name, value in self.changed.items()
        )

    @property
    def keywords(self) -> str:
        """The options as Python keyword arguments."""
        return ", ".join(f"{name}={value!r}" for name, value in self.changed.items())

    @property
    def button(self) -> str:
        """The label of a button that applies the options."""
        buttons = {each.name: each.metadata["button"] for each in fields(self)}
        names = [
            buttons[name] or HEMISPHERES[value].title() for name, value in self.changed.items()
        ]
        return ", ".join([names[0], *(name.lower() for name in names[1:])])


DEFAULT_OPTIONS = MeshOptions()  # options that change nothing when a mesh is loaded

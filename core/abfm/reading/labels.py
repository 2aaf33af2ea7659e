"""Labels of vertices, such as regions of a brain: whole numbers that stand for names."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from abfm.types import BoolArray, IntArray

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, each from 0 to 1."""


@dataclass(frozen=True, eq=False)
class Labels:
    """One key for each vertex, and what the keys mean; keys have no order and no in-between.

    Attributes
    ----------
    values : (n,) array of int
        Keys. Those without a name mean what the file's format says: no label is -1 in what
        FreeSurfer writes, and in GIFTI mostly the key 0, which is called "???" there.
    names : mapping of keys to str
        It may name keys that no vertex has.
    colors : mapping of keys to `Color`
        It may lack some.
    """

    values: IntArray
    names: Mapping[int, str] = field(default_factory=dict)
    colors: Mapping[int, Color] = field(default_factory=dict)

    def where(self, label: str | int) -> BoolArray:
        """Return which vertices, (n,), have a label, given by its name or else by its key.

        A KeyError says that there is none: no name, nor a key of a name or a vertex.
        """
        keys = [key for key, name in self.names.items() if name == label]
        if not keys:
            try:
                keys = [int(label)]
            except ValueError:
                raise KeyError(label) from None
        found: BoolArray = np.isin(self.values, keys)
        if keys[0] not in self.names and not found.any():
            raise KeyError(label)
        return found

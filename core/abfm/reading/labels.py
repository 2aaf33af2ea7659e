"""Labels of vertices, such as regions of a brain: whole numbers that stand for names."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from abfm.types import BoolArray, IntArray

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, each from 0 to 1."""
NO_LABEL = -1
"""Key of vertices without a label, unless the labels name it."""
_UNKNOWN_NAMES = ("???", "unknown")


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

    def with_unknown(self) -> "Labels":
        """Return labels whose vertices without a label have a key with a name, as GIFTI files
        expect: the one called "???" or "unknown", otherwise a free one, 0 if possible.
        """
        absent = self.values == NO_LABEL
        if NO_LABEL in self.names or not absent.any():
            return self
        named = [key for key, name in self.names.items() if name.lower() in _UNKNOWN_NAMES]
        taken = {*self.names, *np.unique(self.values).tolist()}
        key = named[0] if named else next(key for key in count() if key not in taken)
        return replace(
            self,
            values=np.where(absent, key, self.values),
            names=self.names if named else {key: _UNKNOWN_NAMES[0], **self.names},
            colors=self.colors if named else {**self.colors, key: (0.0, 0.0, 0.0, 0.0)},
        )

    def where(self, label: str | int) -> BoolArray:
        """Return which vertices, (n,), have a label, given by its name or else by its key.

        A KeyError reports that there is none: no name, nor a key of a name or a vertex.
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

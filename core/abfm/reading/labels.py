"""Labels of vertices, such as regions of a brain: integer keys with names and colours."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from abfm.types import BoolArray, IntArray

Color = tuple[float, float, float, float]  # red, green, blue and opacity, each from 0 to 1
NO_LABEL = -1  # key of vertices without a label, unless this key has a name
_UNKNOWN_NAMES = ("???", "unknown")


@dataclass(frozen=True, eq=False)
class Labels:
    """A key for each vertex, and the names and colours of the keys.

    Keys are categories: they cannot be ordered or interpolated.

    Attributes
    ----------
    values : (n,) array of int
        Key of each vertex. The meaning of keys without a name depends on the file format. Vertices
        without a label have the key -1 in FreeSurfer files, and usually the key 0, named "???", in
        GIFTI files.
    names : mapping of keys to str
        Names by key; there may be names for keys that no vertex has.
    colors : mapping of keys to `Color`
        Colours by key; keys may be missing.
    """

    values: IntArray
    names: Mapping[int, str] = field(default_factory=dict)
    colors: Mapping[int, Color] = field(default_factory=dict)

    def with_unknown(self) -> "Labels":
        """Return labels in which vertices without a label have a named key, as GIFTI requires.

        It is named "???" or "unknown", or is the smallest unused key from 0.
        """
        absent = self.values == NO_LABEL
        if NO_LABEL in self.names or not absent.any():
            return self
        named = [key for key, name in self.names.items() if name.lower() in _UNKNOWN_NAMES]
        used = {*self.names, *np.unique(self.values).tolist()}
        key = named[0] if named else next(key for key in count() if key not in used)
        return replace(
            self,
            values=np.where(absent, key, self.values),
            names=self.names if named else {key: _UNKNOWN_NAMES[0], **self.names},
            colors=self.colors if named else {**self.colors, key: (0.0, 0.0, 0.0, 0.0)},
        )

    def where(self, label: str | int) -> BoolArray:
        """Return whether each vertex (n,) has a label, which is a name or else a key.

        Raises
        ------
        KeyError
            If no label has this name, and neither a name nor a vertex has this key.
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

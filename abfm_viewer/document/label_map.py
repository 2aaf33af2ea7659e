"""Labels of regions on surface A, or on the only surface, which are shown and transferred.

Labels are never averaged.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, field

import numpy as np

from abfm import TriangleMesh
from abfm.pages.front import Triple, triple
from abfm.reading.labels import Labels
from abfm.types import FloatArray, IntArray

_GREY = (0.75, 0.75, 0.75)
_GOLDEN_RATIO = 0.6180339887498949  # multiples of it, modulo 1, are distinct hues


@dataclass(frozen=True, eq=False)
class LabelMap:
    """Labels of the vertices of a mesh, as integer keys; each key has a name and an sRGB colour."""

    file: str  # name of the file
    keys: tuple[int, ...]  # in ascending order
    names: tuple[str, ...]
    colors: tuple[Triple, ...]
    values: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (V,), keys

    @classmethod
    def of(cls, file: str, mesh: TriangleMesh, labels: Labels) -> LabelMap:
        """Return a label map for a mesh, from labels of the vertices of the mesh or of its file.

        A label without a colour gets one: grey if it has no name but others do. Labels that do not
        fit the mesh raise a `FunctionError`.
        """
        values = mesh.restrict(labels.values).astype(np.int64)
        keys = np.unique([*np.unique(values), *labels.names]).tolist()
        names = tuple(labels.names.get(key, "") for key in keys)
        colors = []
        for number, (key, name) in enumerate(zip(keys, names, strict=True)):
            made = colorsys.hsv_to_rgb(number * _GOLDEN_RATIO % 1, 0.55, 0.85)
            made = _GREY if labels.names and not name else made
            colors.append(triple(np.array(labels.colors.get(key, made)[:3])))
        return cls(file, tuple(keys), names, tuple(colors), values)

    def linear_colors(self, values: IntArray) -> FloatArray:
        """Return the colours (V, 3), in linear light, of label keys (V,)."""
        table = np.array(self.colors) ** 2.2
        return np.asarray(table[np.searchsorted(self.keys, values)])

    def labels(self, values: IntArray) -> Labels:
        pairs = zip(self.keys, self.names, strict=True)
        colors = {key: (*color, 1.0) for key, color in zip(self.keys, self.colors, strict=True)}
        return Labels(values, {key: name for key, name in pairs if name}, colors)

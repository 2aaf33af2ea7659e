"""Colours of the faces of a mesh file, and the reader of those of PLY files."""

from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from abfm.mesh.readers.contents import split_polygons
from abfm.mesh.readers.ply import ply_contents
from abfm.reading import Opened
from abfm.types import FloatArray, IntArray

Wrap: TypeAlias = Literal["repeat", "clamp", "mirror"]
Color: TypeAlias = tuple[float, float, float, float]
WHITE: Color = (1.0, 1.0, 1.0, 1.0)


class Material(NamedTuple):
    """A colour, and an image (or None) that is multiplied by it, as the bytes of its file.

    The colour is sRGB red, green, blue and opacity, from 0 to 1.
    """

    image: bytes | None = None
    color: Color = WHITE
    wraps: tuple[Wrap, Wrap] = ("repeat", "repeat")
    """Continuation of the image beyond its borders, horizontally and vertically."""
    alpha_mode: str = "OPAQUE"  # use of the opacity, as in glTF: OPAQUE, MASK or BLEND


class ColoredFaces(NamedTuple):
    """Vertices and faces (F, 3) as `load_mesh` reads them, and the colours of their corners."""

    vertices: FloatArray
    faces: IntArray
    coordinates: FloatArray
    """Texture coordinates (F, 3, 2): right and up, from 0 to 1 over the image; NaN if missing."""
    colors: FloatArray  # (F, 3, 4) factors of the colour of the material
    owners: IntArray  # (F,) the material of each face
    materials: tuple[Material, ...]


def colored_ply(opened: Opened) -> ColoredFaces:
    """Read a PLY file with the colours of its vertices; images are not read."""
    file = ply_contents(opened)
    faces = split_polygons(file.vertices, file.sizes, file.corners).faces
    colors = np.ones((len(file.vertices), 4)) if file.colors is None else file.colors
    coordinates, owners = np.full((len(faces), 3, 2), np.nan), np.zeros(len(faces), dtype=np.int64)
    at_corners = colors[inside(faces, len(colors))]
    return ColoredFaces(file.vertices, faces, coordinates, at_corners, owners, (Material(),))


def inside(faces: IntArray, count: int) -> IntArray:
    """Return faces unchanged; ValueError if a corner is not one of ``count`` vertices."""
    if faces.size and not 0 <= faces.min() <= faces.max() < count:
        raise ValueError(
            f"a face refers to a vertex that does not exist; the file has {count} vertices"
        )
    return faces

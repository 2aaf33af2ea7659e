"""What gives the faces of a file their colours, and the readers of it that need few lines: PLY."""

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
    """An image, as the bytes of its file, and the colour that it is multiplied by.

    Colours are red, green, blue (sRGB) and opacity, each from 0 to 1.
    """

    image: bytes | None = None
    color: Color = WHITE
    wraps: tuple[Wrap, Wrap] = ("repeat", "repeat")
    """What is beyond the image, to the sides and above and below."""
    alpha_mode: str = "OPAQUE"
    """What opacity means, as glTF has it: OPAQUE, MASK or BLEND."""


class ColoredFaces(NamedTuple):
    """Vertices and faces (F, 3) as `load_mesh` reads them, and what corners of faces have."""

    vertices: FloatArray
    faces: IntArray
    coordinates: FloatArray
    """(F, 3, 2), to the right and up, from 0 to 1 over the image; NaN where there are none."""
    colors: FloatArray
    """(F, 3, 4), which the material's colour is multiplied by."""
    owners: IntArray
    """(F,), the material of each face."""
    materials: tuple[Material, ...]


def colored_ply(opened: Opened) -> ColoredFaces:
    """Read a PLY file with the colours of its vertices; images that it may name are not read."""
    file = ply_contents(opened)
    faces = split_polygons(file.vertices, file.sizes, file.corners).faces
    colors = np.ones((len(file.vertices), 4)) if file.colors is None else file.colors
    return ColoredFaces(
        file.vertices,
        faces,
        np.full((len(faces), 3, 2), np.nan),
        colors[inside(faces, len(colors))],
        np.zeros(len(faces), dtype=np.int64),
        (Material(),),
    )


def inside(faces: IntArray, count: int) -> IntArray:
    """Return the faces if they name vertices that there are, or raise a ValueError."""
    if faces.size and not 0 <= faces.min() <= faces.max() < count:
        raise ValueError(f"a face names a vertex that is none of its {count}")
    return faces

"""Texture atlas of any mesh: each face has a right triangle of texels in proportion to its size."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.calculus.channels import channels
from abfm.calculus.operators import edge_lengths
from abfm.errors import ParameterError
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray

SIZE_MAX = 16384  # texels along a side that graphics cards support
_MARGIN = 0.5  # texels from the legs to the rectangle's sides: texel centres lie on the legs
_RECTANGLE_SIDE_MIN = 4  # side of a rectangle whose triangles have legs of one texel
_BISECTIONS = 14  # bisections to find the texel length


@dataclass(frozen=True, eq=False)
class TextureAtlas:
    """The place of each triangle of a mesh in a square texture; see `texture_atlas`.

    Texel (row, column) covers the square from (column, row) to (column + 1, row + 1); row 0 is at
    the bottom. Linear filtering also reads texels around a triangle; these belong to the triangle.
    """

    mesh: TriangleMesh
    size: int  # texels along a side
    # largest length of a texel on the surface, in the mesh's units, except in very small textures
    texel_length: float
    corners: FloatArray  # (F, 3, 2), places of the corners of each face, x and y in texels
    texel_faces: NDArray[np.int32]  # (size, size), the face of each texel, or -1

    @cached_property
    def corner_coordinates(self) -> FloatArray:
        """Texture coordinates (3F, 2) in [0, 1], corner by corner, in the format of polyscope."""
        return self.corners.reshape(-1, 2) / self.size

    def points(self, rows: IntArray, columns: IntArray) -> SurfacePoints:
        """Return the points of the surface at the centres of texels (P,).

        Beyond the edge of its face, a texel shows a point on that edge.
        """
        faces = self.texel_faces[rows, columns].astype(np.int64)
        origin, first, second = np.moveaxis(self.corners[faces], 1, 0)
        u, v, w = first - origin, second - origin, np.stack([columns, rows], axis=1) + 0.5 - origin
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        b = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
        c = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
        weights = np.maximum(np.stack([1 - b - c, b, c], axis=1), 0)
        weights /= weights.sum(axis=1, keepdims=True)
        return SurfacePoints(self.mesh, faces, weights)

    def affine(self, h: ArrayLike) -> FloatArray:
        """Return the coefficients (F, 3) of a function on each face as ``a + b x + c y``.

        ``h`` (V,) has its values at the vertices. The position (x, y) in the texture is in texels.
        """
        h0, h1, h2 = channels(self.mesh, h, "h")[0][self.mesh.faces].T
        origin, first, second = np.moveaxis(self.corners, 1, 0)
        u, v = first - origin, second - origin
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        along_x = ((h1 - h0) * v[:, 1] - (h2 - h0) * u[:, 1]) / area
        along_y = ((h2 - h0) * u[:, 0] - (h1 - h0) * v[:, 0]) / area
        at_zero = h0 - along_x * origin[:, 0] - along_y * origin[:, 1]
        return np.stack([at_zero, along_x, along_y], axis=1)


def texture_atlas(mesh: TriangleMesh, size: int = 2048) -> TextureAtlas:
    """Lay out the triangles of a mesh in a square texture of ``size`` texels a side, up to 16384.

    At least 2 texels per face are needed; 100 show detail. The atlas is made once per mesh and
    size. Each triangle becomes a right triangle with the longest edge as its hypotenuse. The legs
    are as long in texels as the other two edges in units of ``texel_length``, but at least one
    texel. Two triangles of similar size share a rectangle. All texels that linear filtering reads
    for a triangle belong to that triangle.
    """
    if not isinstance(size, int | np.integer) or not _RECTANGLE_SIDE_MIN <= size <= SIZE_MAX:
        raise ParameterError(
            f"size is {size!r}; expected an integer number of texels from {_RECTANGLE_SIDE_MIN} "
            f"to {SIZE_MAX}"
        )
    rectangles = -(-len(mesh.faces) // 2)
    if rectangles > (size // _RECTANGLE_SIDE_MIN) ** 2:
        least = _RECTANGLE_SIDE_MIN * int(np.ceil(np.sqrt(rectangles)))
        raise ParameterError(
            f"size {size} is too small for {len(mesh.faces)} faces; expected at least {least}"
        )
    return _lay_out(mesh, int(size))


@per_mesh
def _lay_out(mesh: TriangleMesh, size: int) -> TextureAtlas:
    # first the corner opposite the longest edge, then the other two, the farther one first
    edges = edge_lengths(mesh)[mesh.face_edges]
    by_edge = np.argsort(edges, axis=1, kind="stable")
    order, legs = by_edge[:, [2, 0, 1]], np.take_along_axis(edges, by_edge[:, [1, 0]], axis=1)
    area = float((legs[:, 0] * legs[:, 1]).sum()) / 2
    fine, coarse = np.sqrt(area) / size, float(legs.max())
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(fine * coarse))
        fine, coarse = (fine, middle) if _pack(legs / middle, size)[0] else (middle, coarse)
    _, sequence, sides, corners = _pack(legs / coarse, size)
    count = len(mesh.faces)
    owners = np.full(2 * len(sides), -1)
    owners[:count] = sequence
    faces = np.full((size, size), -1, dtype=np.int32)
    halve_rectangles(corners, sides, owners.reshape(-1, 2), faces)

    aspect = sides[:, ::-1] / sides
    lengths = sides - 1 - _MARGIN - (1 + _MARGIN) / aspect
    roots = np.stack([corners + _MARGIN, corners + sides - _MARGIN], axis=1).reshape(-1, 2)[:count]
    steps = np.stack([lengths, -lengths], axis=1).reshape(-1, 2)[:count]
    legs_of = np.concatenate([np.zeros((count, 1, 2)), steps[:, None] * np.eye(2)], axis=1)
    places = np.empty((count, 3, 2))
    places[sequence[:, None], order[sequence]] = roots[:, None] + legs_of
    return TextureAtlas(mesh, size, coarse, places, faces)


def _pack(legs: FloatArray, size: int) -> tuple[bool, IntArray, IntArray, IntArray]:
    """Pair triangles with legs (F, 2), in texels, in rectangles, and place these in a square.

    Return whether all rectangles fit, the sequence of the triangles, and the sides and corners of
    the rectangles.
    """
    lost = 1 + _MARGIN
    heights = np.ceil(legs[:, 1] + 2 * lost - 1e-9)
    widths = np.ceil((legs[:, 0] + lost) / (1 - lost / heights) - 1e-9)
    sides = np.maximum(np.stack([widths, heights], axis=1), _RECTANGLE_SIDE_MIN)
    sides = np.minimum(sides, SIZE_MAX + 1).astype(np.int16)
    sequence = np.lexsort(-sides.T)
    padded = np.concatenate([sides[sequence], np.zeros((len(sides) % 2, 2), dtype=np.int16)])
    rectangles = padded.reshape(-1, 2, 2).max(axis=1).astype(np.int64)
    corners = np.empty_like(rectangles)
    return set_on_shelves(rectangles, size, corners), sequence, rectangles, corners


@kernel
def set_on_shelves(sides: IndexArray, size: int, corners: IndexArray) -> bool:
    """Place rectangles of descending height on shelves of a square; return whether all fit."""
    x, y, shelf = 0, 0, 0
    for i in range(sides.shape[0]):
        width, height = sides[i, 0], sides[i, 1]
        if x + width > size:
            x, y, shelf = 0, y + shelf, 0
        shelf = max(shelf, height)
        if width > size or y + shelf > size:
            return False
        corners[i, 0], corners[i, 1] = x, y
        x += width
    return True


@kernel
def halve_rectangles(
    corners: IndexArray, sides: IndexArray, owners: IndexArray, texels: IndexArray
) -> None:
    """Write to ``texels`` the face of each texel: below or above its rectangle's diagonal."""
    for i in range(sides.shape[0]):
        w, h = sides[i, 0], sides[i, 1]
        for row in range(h):
            for column in range(w):
                above = (2 * column + 1) * h + (2 * row + 1) * w > 2 * w * h
                texels[corners[i, 1] + row, corners[i, 0] + column] = owners[i, 1 if above else 0]

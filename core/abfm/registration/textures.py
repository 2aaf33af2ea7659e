"""Textures of surfaces and their transfer to corresponding surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import AbfmError, ParameterError, brief
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.mesh.readers.colored import Wrap
from abfm.numerics.real_numbers import real_numbers
from abfm.registration.correspondence import Correspondence
from abfm.streaks.texture_atlas import TextureAtlas, texture_atlas
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

Image = NDArray[np.uint8]
_SIZE_DEFAULT = 2048  # texels along a side; about 100 texels for each of 40,000 faces
_DEFAULT_SIZE_FACES_MAX = 40_000  # larger meshes get a texture of twice this size
_CHUNK = 1 << 17  # texels between two checks whether the task is paused or cancelled
_COORDINATE_MAX = 1e6  # beyond it double precision does not distinguish pixels
_REPEAT: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True, eq=False)
class Texture:
    """Images on a surface, interpolated linearly between the centres of their pixels.

    Attributes
    ----------
    mesh : TriangleMesh
        Surface with F faces.
    coordinates : (F, 3, 2) array
        Positions of the corners of each face in its image, to the right and up. The lower left
        corner of an image is (0, 0), its upper right corner (1, 1).
    images : sequence of (H, W, C) arrays of uint8
        Pixels from the top row down. All images have the same number C of channels, such as three
        or four.
    owners : (F,) array of int
        Index of the image of each face; by default 0 for all.
    wraps : sequence of pairs of "repeat", "clamp", "mirror"
        Continuation of each image beyond its edges, horizontally and vertically; by default
        "repeat".
    tints : (F, 3, C) array, optional
        Factors from 0 to 1 at the corners of faces, which multiply the colours of the images.

    Raises
    ------
    ParameterError
        If an array has a wrong shape, type or range.
    """

    mesh: TriangleMesh
    coordinates: FloatArray
    images: Sequence[Image]
    owners: IntArray = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    wraps: Sequence[tuple[Wrap, Wrap]] = (_REPEAT,)
    tints: FloatArray | None = None

    def __post_init__(self) -> None:
        count, images = len(self.mesh.faces), tuple(map(np.asarray, self.images))
        kinds = {(image.dtype.name, image.ndim, image.shape[2:]) for image in images}
        if [kind[:2] for kind in kinds] != [("uint8", 3)] or not all(x.size for x in images):
            given = ", ".join(f"{image.shape} of {image.dtype}" for image in images[:3])
            raise ParameterError(
                f"images are {given or 'none'}; expected (H, W, C) arrays of uint8, all with the "
                "same number of channels"
            )
        owners = np.asarray(self.owners)
        if owners.dtype.kind not in "iu" or owners.shape not in ((1,), (count,)):
            raise ParameterError(
                f"owners have shape {owners.shape} of {owners.dtype}; expected ({count},) integers"
            )
        if not 0 <= owners.min() <= owners.max() < len(images):
            raise ParameterError(
                f"owners are {owners.min()} to {owners.max()}; expected image numbers from 0 to "
                f"{len(images) - 1}"
            )
        wraps = tuple(self.wraps) * (len(images) if len(self.wraps) == 1 else 1)
        modes = {mode for pair in wraps for mode in pair}
        if len(wraps) != len(images) or not modes <= _WRAPPED.keys():
            raise ParameterError(
                f"wraps are {brief(wraps)}; expected a pair of {', '.join(_WRAPPED)} for each image"
            )
        shape = count, 3, 2
        limit = _COORDINATE_MAX
        coordinates = _numbers(self.coordinates, "coordinates", shape, -limit, limit)
        tints = self.tints
        if tints is not None:
            tints = _numbers(tints, "tints", (count, 3, images[0].shape[2]), 0, 1)
        owners = np.broadcast_to(owners, count)
        checked = {"coordinates": coordinates, "images": images, "owners": owners, "wraps": wraps}
        for name, value in (checked | {"tints": tints}).items():
            object.__setattr__(self, name, value)

    def at(self, points: SurfacePoints) -> FloatArray:
        """Return the colours at points of the surface, (P, C), from 0 to 255."""
        weights, faces = points.barycentric, points.faces
        places = np.einsum("pc,pcx->px", weights, self.coordinates[faces])
        found = np.empty((len(faces), self.images[0].shape[2]))
        owners = self.owners[faces]
        for k in np.unique(owners):
            here = owners == k
            found[here] = _sampled(self.images[k], self.wraps[k], places[here])
        if self.tints is not None:
            found *= np.einsum("pc,pck->pk", weights, self.tints[faces])
        return found


def transfer_texture(
    correspondence: Correspondence, texture: Texture, size: int | None = None
) -> Texture:
    """Transfer a texture of surface A to surface B, as one image with a new layout.

    The centre of each texel (pixel of the new image) gets the colour of the corresponding point of
    A. This is exact if the correspondence maps points inside faces exactly. Texels beyond the edge
    of a face repeat its edge, so linear filtering mixes no colours of other faces. Use the image
    without mipmaps, which would mix them.

    Parameters
    ----------
    correspondence : Correspondence
        Correspondence of A and B.
    texture : Texture
        Texture of A; its mesh has the faces of A.
    size : int, optional
        Texels along a side of B's image; by default 2048, and 4096 for more than 40,000 faces.
    """
    if not np.array_equal(texture.mesh.faces, correspondence.a.faces):
        raise AbfmError(
            f"the texture belongs to a surface with {len(texture.mesh.faces)} faces; expected the "
            f"{len(correspondence.a.faces)} faces of surface A"
        )
    points = correspondence.points
    if size is None:
        size = _SIZE_DEFAULT * (2 if len(points.domain.faces) > _DEFAULT_SIZE_FACES_MAX else 1)
    atlas = texture_atlas(points.domain, size)
    image = np.zeros((atlas.size, atlas.size, texture.images[0].shape[2]), dtype=np.uint8)
    with step("transferring the texture", atlas.size**2) as done:
        for rows, columns in _texels(atlas):
            checkpoint()
            found = texture.at(points.at(atlas.points(rows, columns)))
            image[atlas.size - 1 - rows, columns] = np.round(found)
            done(float(rows[-1] + 1) / atlas.size)
    is_used = atlas.texel_faces[::-1] >= 0
    image[~is_used] = np.round(image[is_used].mean(axis=0))
    return Texture(correspondence.b, atlas.corners / atlas.size, [image], wraps=[("clamp",) * 2])


def _texels(atlas: TextureAtlas) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield rows and columns of the texels inside faces, in chunks from the bottom up."""
    chunk_rows = max(_CHUNK // atlas.size, 1)
    for start in range(0, atlas.size, chunk_rows):
        rows, columns = np.nonzero(atlas.texel_faces[start : start + chunk_rows] >= 0)
        if len(rows):
            yield rows + start, columns


def _sampled(image: Image, wraps: tuple[Wrap, Wrap], places: FloatArray) -> FloatArray:
    """Return the colours (P, C) at positions (P, 2) of an image by bilinear interpolation.

    ``wraps`` continue the image beyond its edges, see `Texture`.
    """
    height, width = image.shape[:2]
    x, y = places[:, 0] * width - 0.5, (1 - places[:, 1]) * height - 0.5
    left, top = np.floor(x), np.floor(y)
    right_share, lower_share = (x - left)[:, None], (y - top)[:, None]
    across, down = _WRAPPED[wraps[0]], _WRAPPED[wraps[1]]
    columns = across(left, width), across(left + 1, width)
    rows = down(top, height), down(top + 1, height)
    upper, lower = (
        image[row, columns[0]] * (1 - right_share) + image[row, columns[1]] * right_share
        for row in rows
    )
    found: FloatArray = upper * (1 - lower_share) + lower * lower_share
    return found


def _repeated(pixels: FloatArray, count: int) -> IntArray:
    return np.mod(pixels, count).astype(np.int64)


def _clamped(pixels: FloatArray, count: int) -> IntArray:
    return np.clip(pixels, 0, count - 1).astype(np.int64)


def _mirrored(pixels: FloatArray, count: int) -> IntArray:
    there = _repeated(pixels, 2 * count)
    return np.minimum(there, 2 * count - 1 - there)


_WRAPPED: dict[Wrap, Callable[[FloatArray, int], IntArray]] = {
    "repeat": _repeated,
    "clamp": _clamped,
    "mirror": _mirrored,
}


def _numbers(
    values: ArrayLike, name: str, shape: tuple[int, ...], least: float, most: float
) -> FloatArray:
    found = real_numbers(values, name, ParameterError)
    if found.shape != shape:
        raise ParameterError(f"{name} have shape {found.shape}; expected {shape}")
    wrong = found[~((found >= least) & (found <= most))]
    if wrong.size:
        raise ParameterError(
            f"{name} have the value {wrong[0]:g}; expected numbers from {least:g} to {most:g}"
        )
    return found

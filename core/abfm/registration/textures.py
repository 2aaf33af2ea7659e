"""Textures of surfaces, carried along correspondences: images that lie on faces."""

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
# which have 100 texels each
_USUAL_SIZE = 2048
_MANY_FACES = 40_000
_CHUNK = 1 << 17  # texels between checkpoints
_COORDINATE_MAX = 1e6  # of coordinates: beyond, doubles do not tell pixels
_REPEAT: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True, eq=False)
class Texture:
    """Images on a surface, linear between the centres of their pixels.

    Attributes
    ----------
    mesh : TriangleMesh
    coordinates : (F, 3, 2) array
        Where the corners of each face lie in its image: to the right and up from the lower left
        corner, which is (0, 0), to the upper right one, which is (1, 1).
    images : sequence of (H, W, C) arrays of uint8
        From the top row down, such as three or four channels; all with as many.
    owners : (F,) array of int
        The image of each face; by default the first one.
    wraps : sequence of pairs of "repeat", "clamp", "mirror"
        What is beyond each image, to the sides and above and below; by default it repeats.
    tints : (F, 3, C) array, optional
        Of corners of faces, from 0 to 1, which colours of images are multiplied by.

    Raises
    ------
    ParameterError
        If shapes, types or numbers do not fit.
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
                f"images are {given or 'none'}; expected (H, W, C) of uint8, all with as many "
                "channels"
            )
        owners = np.asarray(self.owners)
        are_numbers = owners.dtype.kind in "iu" and owners.shape in ((1,), (count,))
        if not are_numbers or not 0 <= owners.min() <= owners.max() < len(images):
            raise ParameterError(
                f"owners have shape {owners.shape} of {owners.dtype}; expected ({count},) numbers "
                f"of images, 0 to {len(images) - 1}"
            )
        wraps = tuple(self.wraps) * (len(images) if len(self.wraps) == 1 else 1)
        if len(wraps) != len(images) or not {way for pair in wraps for way in pair} <= _WAYS.keys():
            raise ParameterError(
                f"wraps are {brief(wraps)}; expected a pair of {', '.join(_WAYS)} for each image"
            )
        shape = count, 3, 2
        places = _numbers(self.coordinates, "coordinates", shape, -_COORDINATE_MAX, _COORDINATE_MAX)
        tints = self.tints
        if tints is not None:
            tints = _numbers(tints, "tints", (count, 3, images[0].shape[2]), 0, 1)
        owners = np.broadcast_to(owners, count)
        checked = {"coordinates": places, "images": images, "owners": owners, "wraps": wraps}
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
    """Carry a texture of surface A to surface B, as one image that is laid out anew.

    The centre of each texel is a point of B; it gets the colour of A where that point lies on A,
    exactly as far as the correspondence knows points inside faces. Seams of A's texture are where
    they are on A. Texels beyond the edge of a face show its edge, so that linear filtering sees
    nothing of other faces: use the image without mipmaps, which do.

    Parameters
    ----------
    texture : Texture
        Of A: a mesh with its faces.
    size : int, optional
        Texels along a side of B's image; by default 2048, and 4096 for more than 40,000 faces.
    """
    if not np.array_equal(texture.mesh.faces, correspondence.a.faces):
        raise AbfmError(
            f"the texture is of a surface with {len(texture.mesh.faces)} faces, not of surface A, "
            f"with {len(correspondence.a.faces)}"
        )
    points = correspondence.points
    if size is None:
        size = _USUAL_SIZE * (2 if len(points.domain.faces) > _MANY_FACES else 1)
    atlas = texture_atlas(points.domain, size)
    image = np.zeros((atlas.size, atlas.size, texture.images[0].shape[2]), dtype=np.uint8)
    with step("carrying the texture", atlas.size**2) as done:
        for rows, columns in _shown(atlas):
            checkpoint()
            found = texture.at(points.at(atlas.points(rows, columns)))
            image[atlas.size - 1 - rows, columns] = np.round(found)
            done(float(rows[-1] + 1) / atlas.size)
    is_shown = atlas.texel_faces[::-1] >= 0
    image[~is_shown] = np.round(image[is_shown].mean(axis=0))
    return Texture(correspondence.b, atlas.corners / atlas.size, [image], wraps=[("clamp",) * 2])


def _shown(atlas: TextureAtlas) -> Iterator[tuple[IntArray, IntArray]]:
    """Return rows and columns of the texels of faces, some at a time, from the bottom up."""
    some = max(_CHUNK // atlas.size, 1)
    for start in range(0, atlas.size, some):
        rows, columns = np.nonzero(atlas.texel_faces[start : start + some] >= 0)
        if len(rows):
            yield rows + start, columns


def _sampled(image: Image, wraps: tuple[Wrap, Wrap], places: FloatArray) -> FloatArray:
    """Return colours at places (P, 2) of an image, (P, C), linear between centres of pixels."""
    height, width = image.shape[:2]
    x, y = places[:, 0] * width - 0.5, (1 - places[:, 1]) * height - 0.5
    left, top = np.floor(x), np.floor(y)
    right_share, lower_share = (x - left)[:, None], (y - top)[:, None]
    across, down = _WAYS[wraps[0]], _WAYS[wraps[1]]
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


_WAYS: dict[Wrap, Callable[[FloatArray, int], IntArray]] = {
    "repeat": _repeated,
    "clamp": _clamped,
    "mirror": _mirrored,
}


def _numbers(
    values: ArrayLike, name: str, shape: tuple[int, ...], least: float, most: float
) -> FloatArray:
    found = real_numbers(values, name, ParameterError)
    if found.shape != shape or not ((found >= least) & (found <= most)).all():
        raise ParameterError(
            f"{name} have shape {found.shape}; expected {shape}, numbers from {least:g} to {most:g}"
        )
    return found

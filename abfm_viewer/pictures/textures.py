"""Textures of meshes: images decoded within limits, and files of transferred textures."""

import os
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from abfm import MeshError, TriangleMesh
from abfm.errors import one_line
from abfm.io import write_textured
from abfm.mesh.colors import load_colors
from abfm.registration import Texture
from abfm.workers.progress import step

Pixels = NDArray[np.uint8]
_PIXELS_MAX = 1 << 26  # in all images of a file, with 4 bytes for each pixel
_ROWS_AT_A_TIME = 256
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")
_OPAQUE_MODE = "OPAQUE"
_BLEND_MODE = "BLEND"
_SIXTEEN_BITS = 257  # ratio of 16-bit to 8-bit values


def read_texture(
    path: str | os.PathLike[str], mesh: TriangleMesh, image: str | os.PathLike[str] | None = None
) -> tuple[Texture, str]:
    """Return the texture of a mesh file in four channels (RGBA), and its alpha mode as in glTF.

    An alpha mode is OPAQUE, MASK or BLEND. Colours of vertices and materials become factors of the
    images, or of white. Raises `MeshError` as `abfm.mesh.colors.load_colors`, and if an image is
    damaged, incomplete or too large.
    """
    found = load_colors(path, mesh, image)
    decoded: dict[bytes | None, Pixels] = {None: np.full((1, 1, 4), 255, dtype=np.uint8)}
    available = _PIXELS_MAX
    for material in found.materials:
        data = material.image
        if data is not None and data not in decoded:
            try:
                decoded[data] = _decoded(data, available)
            except Exception as error:  # decoders may raise anything on a bad file
                source = path if image is None else image
                raise MeshError(
                    f"{one_line(source)}: its image cannot be read: {one_line(error)}"
                ) from error
            available -= decoded[data].size // 4
    images = dict.fromkeys((material.image, material.wraps) for material in found.materials)
    numbers = {each: number for number, each in enumerate(images)}
    owners = [numbers[material.image, material.wraps] for material in found.materials]
    factors = np.array([material.color for material in found.materials])
    modes = {material.alpha_mode for material in found.materials}
    tints = found.colors * factors[found.owners][:, None]
    texture = Texture(
        mesh,
        np.where(np.isnan(found.coordinates), 0, found.coordinates),
        [decoded[data] for data, _ in images],
        np.array(owners)[found.owners],
        [wraps for _, wraps in images],
        None if (tints == 1).all() else tints,
    )
    return texture, modes.pop() if len(modes) == 1 else _BLEND_MODE


def write_texture(path: Path, texture: Texture, alpha_mode: str = _BLEND_MODE) -> None:
    """Write a surface with one image of four channels (RGBA); see `abfm.io.write_textured`."""
    [pixels] = texture.images
    opaque = bool((pixels[..., 3] == 255).all())
    data, mode = BytesIO(), _OPAQUE_MODE if opaque else alpha_mode
    with step("writing the texture", pixels.size):
        Image.fromarray(pixels[..., :3] if opaque else pixels).save(data, "PNG")
        write_textured(path, texture.mesh, texture.coordinates, data.getvalue(), mode)


def _decoded(data: bytes, pixels_max: int) -> Pixels:
    """Return a decoded image (H, W, 4); refuse an image of more than ``pixels_max`` pixels."""
    ignored = warnings.catch_warnings(action="ignore")
    with ignored, Image.open(BytesIO(data), formats=_FORMATS) as image:
        if image.width * image.height > pixels_max:
            raise ValueError(
                f"it has {image.width} x {image.height} pixels; expected at most {pixels_max}"
            )
        if image.mode.startswith("I"):  # 16 bits, which Pillow would clip at 255
            grey = np.clip(np.asarray(image) // _SIXTEEN_BITS, 0, 255).astype(np.uint8)
            return np.asarray(Image.fromarray(grey).convert("RGBA"))
        if image.mode == "F":
            raise ValueError("its pixels are floating-point numbers; expected 8 or 16 bits")
        pixels = np.empty((image.height, image.width, 4), dtype=np.uint8)
        for top in range(0, image.height, _ROWS_AT_A_TIME):  # avoids a copy of the image
            rows = image.crop((0, top, image.width, min(top + _ROWS_AT_A_TIME, image.height)))
            pixels[top : top + rows.height] = np.asarray(rows.convert("RGBA"))
        return pixels

"""Base colours of glTF scenes: images, factors, vertex colours (section 3.9 of glTF 2.0)."""

from typing import Any

import numpy as np

from abfm.mesh.readers.colored import ColoredFaces, Material, Wrap
from abfm.mesh.readers.gltf import joined, placed_parts
from abfm.mesh.readers.gltf_document import Document, Part, numbers_of, of
from abfm.reading import Opened
from abfm.types import FloatArray

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_MODES = "OPAQUE", "MASK", "BLEND"


def colored_gltf(opened: Opened) -> ColoredFaces:
    """Read all triangles of a scene with their base colours."""
    document = Document(opened)
    parts = placed_parts(document)
    numbers = [of(part.primitive, "material", int, -1) for part in parts]
    places = {number: place for place, number in enumerate(sorted(set(numbers)))}
    entries = [document.entry("materials", number) if number >= 0 else {} for number in places]
    textures = [of(_base(entry), "baseColorTexture", dict, None) for entry in entries]
    owners = [places[number] for number in numbers]
    at_corners = [
        (_coordinates(document, part, textures[owner]), _colors(document, part))
        for part, owner in zip(parts, owners, strict=True)
    ]
    contents = joined(parts)
    return ColoredFaces(
        contents.vertices,
        contents.faces,
        np.concatenate([np.zeros((0, 3, 2)), *(coordinates for coordinates, _ in at_corners)]),
        np.concatenate([np.zeros((0, 3, 4)), *(colors for _, colors in at_corners)]),
        np.repeat(np.array(owners, dtype=np.int64), [len(part.faces) for part in parts]),
        tuple(_material(document, *each) for each in zip(entries, textures, strict=True)),
    )


def _base(material: dict[str, Any]) -> Any:
    return of(material, "pbrMetallicRoughness", dict, {})


def _material(document: Document, entry: dict[str, Any], texture: Any) -> Material:
    color = np.ones(4)
    if "baseColorFactor" in _base(entry):
        color = np.clip(numbers_of(_base(entry), "baseColorFactor", 4, "material"), 0, 1)
    red, green, blue, opacity = _srgb(color).tolist()
    mode = of(entry, "alphaMode", str, _MODES[0])
    found = Material(None, (red, green, blue, opacity), alpha_mode=mode)
    if texture is None:
        return found
    sampled = document.entry("textures", of(texture, "index", int, None))
    extensions = of(sampled, "extensions", dict, {})
    webp = of(of(extensions, "EXT_texture_webp", dict, {}), "source", int, None)
    image = of(sampled, "source", int, webp)
    if image is None:
        raise ValueError("the texture has no PNG, JPEG or WebP image. Export one of these")
    sampler = of(sampled, "sampler", int, None)
    modes = {} if sampler is None else document.entry("samplers", sampler)
    across, along = (_WRAPS.get(of(modes, name, int, 10497)) for name in ("wrapS", "wrapT"))
    if across is None or along is None:
        raise ValueError("the sampler of the texture has a wrapping mode that glTF does not define")
    return found._replace(image=document.image(image), wraps=(across, along))


def _coordinates(document: Document, part: Part, texture: dict[str, Any] | None) -> FloatArray:
    """Return texture coordinates (F, 3, 2) of corners, from the lower left; NaN without texture."""
    transform = of(of(texture or {}, "extensions", dict, {}), "KHR_texture_transform", dict, {})
    usual = of(texture or {}, "texCoord", int, 0)
    name = f"TEXCOORD_{of(transform, 'texCoord', int, usual)}"
    index = of(of(part.primitive, "attributes", dict, {}), name, int, None)
    if texture is None or index is None:
        return np.full((*part.faces.shape, 2), np.nan)
    places = _at_corners(document, part, index, "VEC2")
    if transform.get("rotation"):
        raise ValueError(
            "the texture is rotated by KHR_texture_transform, which is not supported. Export it "
            "without rotation"
        )
    if "scale" in transform:
        places = places * numbers_of(transform, "scale", 2, "texture")
    if "offset" in transform:
        places = places + numbers_of(transform, "offset", 2, "texture")
    return np.stack([places[..., 0], 1 - places[..., 1]], axis=2)


def _colors(document: Document, part: Part) -> FloatArray:
    """Return the vertex colours of corners in sRGB with opacity, (F, 3, 4); 1 if there are none."""
    colors = np.ones((*part.faces.shape, 4))
    index = of(of(part.primitive, "attributes", dict, {}), "COLOR_0", int, None)
    if index is not None:
        shape = "VEC3" if document.entry("accessors", index).get("type") == "VEC3" else "VEC4"
        found = np.clip(_at_corners(document, part, index, shape), 0, 1)
        colors[..., : found.shape[2]] = found
    return _srgb(colors)


def _at_corners(document: Document, part: Part, index: int, shape: str) -> FloatArray:
    return np.asarray(document.at_vertices(part, index, shape)[part.faces], dtype=np.float64)


def _srgb(colors: FloatArray) -> FloatArray:
    """Convert linear colours (..., 4) to sRGB; in glTF only the colours of images are sRGB."""
    found = colors.copy()
    x = found[..., :3]
    curved = 1 - 1.055 * (1 - x ** (1 / 2.4))  # in this form exactly 1 for x = 1
    found[..., :3] = np.where(x <= 0.0031308, 12.92 * x, curved)
    return found

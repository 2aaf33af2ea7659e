import io
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from abfm import Correspondence, MeshError, load_mesh
from abfm.io import write_textured
from abfm.maps.surface_points import points_by_area
from abfm.registration import Texture, transfer_texture
from abfm_viewer.pictures import read_texture, textures, write_texture
from tests.messages import raises
from tests.shapes import icosphere

MESH = icosphere(1)
PLACES = np.random.default_rng(1).uniform(size=(len(MESH.faces), 3, 2))
PIXELS = np.random.default_rng(0).integers(0, 256, (6, 9, 4)).astype(np.uint8)


def encoded(image, form="PNG", **settings):
    data = io.BytesIO()
    image.save(data, form, **settings)
    return data.getvalue()


def read(tmp_path, data):
    write_textured(tmp_path / "a.glb", MESH, PLACES, data)
    return read_texture(tmp_path / "a.glb", MESH)


RGBA = Image.fromarray(PIXELS)


@pytest.mark.parametrize("mode", ["RGBA", "L", "LA", "P", "1"])
def test_images_have_four_channels(tmp_path, mode):
    image = RGBA.convert(mode)
    [found] = read(tmp_path, encoded(image))[0].images
    assert_array_equal(found, np.asarray(image.convert("RGBA")))


def test_all_formats_and_sixteen_bits_are_read(tmp_path):
    smooth = Image.fromarray(np.tile(np.arange(64, dtype=np.uint8), (64, 1)) + 60).convert("RGB")
    for form, more in (("JPEG", {"quality": 95}), ("WEBP", {}), ("TGA", {}), ("BMP", {})):
        [found] = read(tmp_path, encoded(smooth, form, **more))[0].images
        assert_allclose(found[..., :3], np.asarray(smooth), atol=6)
    sixteen_bits = Image.fromarray(np.asarray(smooth)[..., 0].astype(np.uint16) * 257)
    [found] = read(tmp_path, encoded(sixteen_bits))[0].images
    assert_array_equal(found[..., :3], np.asarray(smooth))


def huge_png():
    """Return the header of an image of 900 million pixels, without the pixels."""
    chunk = b"IHDR" + struct.pack(">2I5B", 30_000, 30_000, 8, 2, 0, 0, 0)
    parts = struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    end = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))
    return b"\x89PNG\r\n\x1a\n" + parts + end


LARGE = Image.fromarray(np.random.default_rng(0).integers(0, 256, (90, 90, 3)).astype(np.uint8))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (encoded(LARGE)[:9000], "truncated|cut|broken"),
        (encoded(LARGE, "JPEG")[:2000], "truncated"),
        (b"", "cannot identify image"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "cannot identify image"),
        (huge_png(), "900000000 pixels"),
        (encoded(Image.new("F", (2, 2)), "TIFF"), "floating-point"),
    ],
    ids=["cut PNG", "cut JPEG", "nothing", "EPS", "huge", "floats"],
)
def test_damaged_and_huge_images_are_refused(tmp_path, data, words):
    with pytest.raises(MeshError, match=f"a.glb: .*({words})") as refused:
        read(tmp_path, data)
    assert "\n" not in str(refused.value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


@pytest.mark.filterwarnings("error")
@given(data=st.data(), form=st.sampled_from(["PNG", "JPEG", "WEBP", "TGA", "BMP", "TIFF"]))
@settings(max_examples=60)
def test_damaged_images_are_read_or_refused(folder, data, form):
    content = bytearray(encoded(RGBA.convert("RGB"), form))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    try:
        [found] = read(folder, bytes(content))[0].images
    except MeshError:
        return
    assert found.shape[2] == 4


def test_limit_applies_to_all_images_together(tmp_path, monkeypatch):
    monkeypatch.setattr(textures, "_PIXELS_MAX", 54)
    assert len(read(tmp_path, encoded(RGBA))[0].images) == 1
    monkeypatch.setattr(textures, "_PIXELS_MAX", 53)
    with raises(MeshError, 9, 6, 53):
        read(tmp_path, encoded(RGBA))


@pytest.mark.parametrize("name", ["b.obj", "b.glb"])
def test_transferred_texture_is_read_again(tmp_path, name):
    texture, mode = read(tmp_path, encoded(RGBA))
    assert mode == "OPAQUE"
    transferred = transfer_texture(Correspondence.of_same_faces(MESH, MESH), texture, 300)
    write_texture(tmp_path / name, transferred, "BLEND")
    again, mode = read_texture(tmp_path / name, load_mesh(tmp_path / name))
    assert mode == "BLEND"
    assert_array_equal(again.images[0], transferred.images[0])
    points = points_by_area(MESH, 500)
    assert_allclose(again.at(points), transferred.at(points), atol=1e-2)
    opaque = np.dstack([PIXELS[..., :3], np.full((6, 9), 255, np.uint8)])
    write_texture(tmp_path / "a.obj", Texture(MESH, PLACES, [opaque]))
    with Image.open(tmp_path / "a.png") as written:
        assert written.mode == "RGB"


def test_materials_and_colors_are_tints(tmp_path):
    (tmp_path / "i.png").write_bytes(encoded(Image.new("RGB", (2, 2), (200, 100, 50))))
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd i.png\nnewmtl b\nKd 0.2 0.4 0.6\nd 0.5\n")
    lines = ["mtllib m.mtl", "vt 0 0"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in MESH.vertices.tolist()]
    for material, rows in (("a", MESH.faces[:40]), ("b", MESH.faces[40:])):
        lines += [f"usemtl {material}"]
        lines += ["f " + " ".join(f"{vertex}/1" for vertex in row) for row in (rows + 1).tolist()]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    texture, mode = read_texture(tmp_path / "a.obj", MESH)
    assert mode == "BLEND"
    found = texture.at(points_by_area(MESH, 100))
    expected = np.array([[200, 100, 50, 255], [51, 102, 153, 127.5]])
    owners = texture.owners[points_by_area(MESH, 100).faces]
    assert_allclose(found, expected[owners])

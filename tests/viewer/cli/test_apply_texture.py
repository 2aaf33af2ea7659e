import io

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from abfm import Correspondence, load_mesh
from abfm.io import export_ply, write_textured
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh.shapes import even_sphere
from abfm_viewer.pictures import read_texture
from tests.messages import check_message
from tests.shapes import icosphere

A, B = icosphere(2), even_sphere(400)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a sphere and its texture (OBJ, glTF), and a map to another sphere."""
    folder = tmp_path_factory.mktemp("textured")
    Correspondence.through_sphere(A, B, A.vertices, B.vertices).save(folder / "c.npz")
    waves = 127 + 100 * np.sin(np.arange(128) / 128 * 2 * np.pi)
    pixels = np.stack([*np.broadcast_arrays(waves, waves[:, None], np.full((128, 128), 90))], -1)
    data = io.BytesIO()
    Image.fromarray(np.round(pixels).astype(np.uint8)).save(data, "PNG")
    places = 0.4 * A.vertices[A.faces][..., :2] + 0.5
    for name in ("a.obj", "a.glb"):
        write_textured(folder / name, A, places, data.getvalue())
    (folder / "skin.png").write_bytes(data.getvalue())
    export_ply(folder / "plain.ply", A, {}, {})
    return folder


@pytest.mark.parametrize("kind", ["obj", "glb"])
def test_texture_round_trip(files, tmp_path, abfm, kind):
    there = tmp_path / f"b.{kind}"
    line = f"apply {{f}}/c.npz --texture={{f}}/a.{kind} --size=512 --out={{t}}/b.{kind}"
    names = [there, *(tmp_path / f"b.{end}" for end in ("mtl", "png") if kind == "obj")]
    assert abfm(line, f=files) == (f"wrote {', '.join(map(str, names))}\n", "")
    b = load_mesh(there)
    assert_array_equal(b.faces, B.faces)
    shown = read_texture(there, b)[0].at(points_by_area(b, 2000))
    x, y, _ = (points_by_area(B, 2000).positions).T
    level = [127 + 100 * np.sin(2 * np.pi * w) for w in (0.4 * x + 0.5, 0.5 - 0.4 * y)]
    assert_allclose(shown[:, :2], np.transpose(level), atol=12)  # the spheres have flat faces
    assert_allclose(shown[:, 2:], np.tile([90.0, 255.0], (2000, 1)))
    line = f"apply {{f}}/c.npz --inverse --texture={{t}}/b.{kind} --size=512 --out={{t}}/back.glb"
    abfm(line, f=files)
    a, points = load_mesh(tmp_path / "back.glb"), points_by_area(A, 2000)
    original = read_texture(files / "a.obj", A)[0].at(points)
    points = SurfacePoints(a, points.faces, points.barycentric)
    assert np.abs(read_texture(tmp_path / "back.glb", a)[0].at(points) - original).mean() < 1


def test_image_option_replaces_a_missing_image(files, tmp_path, abfm):
    text = (files / "a.obj").read_text().replace("mtllib a.mtl", "mtllib lost.mtl")
    (tmp_path / "a.obj").write_text(text)
    line = "apply {f}/c.npz --texture={t}/a.obj --size=96 --out={t}/b.obj"
    assert "lost.mtl" in abfm(line, f=files, status=2).err
    abfm(f"{line} --image {{f}}/skin.png", f=files)
    with Image.open(tmp_path / "b.png") as written:
        assert written.size == (96, 96)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--texture {f}/a.obj --out {t}/b.ply", [".obj", ".glb"]),
        ("--texture {f}/a.obj --out {f}/a.obj", ["a.obj"]),
        ("--texture={f}/a.obj --image={f}/skin.png --out={f}/skin.obj", ["skin.png"]),
        ("--texture {f}/a.obj --out {t}/taken.obj", ["taken.mtl"]),
        ("--texture {f}/a.glb --out {f}/skin.obj", ["skin.png", "skin.obj"]),
        ("--texture {f}/a.obj --inverse --out {t}/b.obj", ["a.obj"]),
        ("--texture {f}/plain.ply --out {t}/b.obj", []),
        ("--texture={f}/a.obj --image={t}/bad.png --out={t}/b.obj", ["bad.png", "image"]),
        ("--texture={f}/a.obj --size=3 --out={t}/b.obj", [4, 16384]),
        ("--texture={f}/a.obj --size=30 --out={t}/b.obj", [796]),
        ("--data={f}/a.npy --image={f}/skin.png --out={t}/b.csv", ["--texture"]),
    ],
)
def test_bad_input_is_refused(line, named, files, tmp_path, abfm):
    (tmp_path / "taken.mtl").mkdir()
    (tmp_path / "bad.png").write_bytes(b"no image")
    before = sorted(files.iterdir()), sorted(tmp_path.iterdir())
    check_message(abfm(f"apply {{f}}/c.npz {line}", f=files, status=2).err, *named)
    assert (sorted(files.iterdir()), sorted(tmp_path.iterdir())) == before

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from abfm_viewer.errors import DrawingError
from abfm_viewer.pictures import canvas
from abfm_viewer.pictures.canvas import draw_parts, rendered
from abfm_viewer.scene import opengl
from abfm_viewer.scene.annotations import Disc
from abfm_viewer.scene.opengl import ps
from tests.messages import raises
from tests.shapes import icosphere


def sphere(width, height, transparent, ground=(1.0, 1.0, 1.0)):
    """Return a grey ball in the middle of a picture."""
    mesh = icosphere(4)
    with canvas.canvas(width, height):
        ps.remove_all_structures()
        ps.set_ground_plane_mode("none")
        ps.set_automatically_compute_scene_extents(True)
        look = {"color": (0.5, 0.5, 0.5), "material": opengl.MATERIAL}
        ps.register_surface_mesh("ball", mesh.vertices, mesh.faces, **look)
        ps.set_vertical_fov_degrees(20)
        ps.look_at_dir((0, 0, 8), (0, 0, 0), (0, 1, 0))
        ps.set_background_color((*ground, 1.0))
        return rendered(transparent)


def test_edges_are_antialiased():
    pixels = sphere(160, 120, transparent=True)
    assert pixels.shape == (120, 160, 4)
    alpha = pixels[..., 3]
    assert (alpha[0] == 0).all()
    assert alpha[60, 80] == 255
    assert len(np.unique(alpha)) == 17
    pixels = sphere(320, 240, transparent=True)
    rim = pixels[(pixels[..., 3] > 60) & (pixels[..., 3] < 200), :3].astype(int)
    inside = pixels[pixels[..., 3] == 255][:, :3].astype(int)
    assert inside.min() - 3 <= rim.min()
    assert rim.max() <= inside.max() + 3


def test_edge_colors_mix_with_any_background():
    pixels = sphere(160, 120, transparent=False, ground=(1.0, 0.0, 0.0))
    assert pixels.shape == (120, 160, 3)
    assert pixels[0, 0].tolist() == [255, 0, 0]
    row = pixels[60, :80, 0].astype(int) - pixels[60, :80, 1]
    assert ((row > 20) & (row < 235)).any()
    sphere(100, 80, transparent=True)
    assert ps.get_window_size() == (64, 64)
    assert len(np.unique(ps.screenshot_to_buffer()[..., 3])) <= 2


def test_opengl_errors_are_drawing_errors(monkeypatch):
    resize = canvas._resize

    def refuse(width, height, side):
        if width > 64:
            raise RuntimeError("[polyscope]  [EXCEPTION] OpenGl error occurred. Text: No memory")
        resize(width, height, side)

    monkeypatch.setattr(canvas, "_resize", refuse)
    with raises(DrawingError, 9000):
        sphere(9000, 9000, transparent=False)


@pytest.mark.parametrize("size", [(8192, 100), (100, 8192)])
def test_long_pictures_respect_the_limit_of_opengl(size):
    with canvas.canvas(*size):
        ps.remove_all_structures()
        assert rendered(transparent=False).shape == (size[1], size[0], 3)


@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
@pytest.mark.parametrize("middle", [(20.3, 15.8), (2.0, 1.0)])
def test_discs_and_rings_are_round(mode, middle):
    picture = Image.new(mode, (40, 30), "white" if mode == "RGB" else (255, 255, 255, 0))
    disc = Disc(middle, 8.0, (1.0, 0.0, 0.0, 1.0))
    draw_parts(picture, [disc, replace(disc, color=(0.0, 0.0, 1.0, 1.0), hole=6.0)], None, None)
    pixels = np.asarray(picture).astype(int)
    y, x = np.mgrid[:30, :40] + 0.5
    away = np.hypot(x - middle[0], y - middle[1])
    red, blue = pixels[away < 5.2, :3], pixels[(away > 6.8) & (away < 7.2), :3]
    assert (red == [255, 0, 0]).all()
    assert (blue == [0, 0, 255]).all()
    outside = pixels[away > 8.8]
    assert (outside == ([255, 255, 255] if mode == "RGB" else [255, 255, 255, 0])).all()

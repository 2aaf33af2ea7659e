import numpy as np

from abfm_viewer.pictures.thumbnails import thumbnail
from tests.shapes import icosphere

BALL = icosphere(3)
SIZE = 100, 80


def test_a_ball_is_a_disc_in_the_middle():
    pixels = np.asarray(thumbnail([(BALL, None)], SIZE))
    assert pixels.shape == (80, 100, 4)
    covered = pixels[..., 3] / 255
    rows, columns = np.indices(covered.shape) + 0.5
    radius = np.sqrt(covered.sum() / np.pi)
    assert 0.85 * 40 < radius < 40
    distances = np.hypot(rows - 40, columns - 50)
    assert covered[distances < radius - 1.5].min() > 0.7
    assert covered[distances > radius + 1.5].max() == 0


def test_nearest_faces_and_one_colour_range_are_drawn():
    """A function of depth shows its values at the front alone, in the range of all functions."""
    x, y, z = BALL.vertices.T
    views = [(BALL, values) for values in (np.abs(z) + np.abs(x) + np.abs(y), 0 * x + 5)]
    pixels = np.asarray(thumbnail(views, SIZE))
    first, second = (pixels[top : top + 4, 48:52, :3].mean() for top in (38, 118))
    assert first > second + 20  # small values are lighter than large ones

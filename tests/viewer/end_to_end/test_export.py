import csv

import av
import numpy as np
import pytest
from PIL import Image

import abfm

WINDOW = (640, 600)  # high enough for a tab below a verdict with a warning


def exported(gui, button, path):
    """Press a button, name the file, and wait until it is written."""
    gui.click(button)
    gui.type("file name", path.name, enter=False)
    gui.click("Save")
    gui.wait(lambda _: path.exists() and not gui.window.exporter.running, 60)
    assert not gui.window.exporter.failed, gui.window.exporter.message


def test_tour_of_export(matched, tmp_path):
    """All settings of the tab are used for small pictures, short movies and data."""
    set_sizes_and_save_results(matched, tmp_path)
    save_movies(matched, tmp_path)
    save_pictures(matched, tmp_path)


def set_sizes_and_save_results(matched, tmp_path):
    exporter, (left, top, right, bottom) = matched.window.exporter, matched.window.parts.scene

    def size():
        return exporter.picture.width, exporter.picture.height

    sizes = {"4K": (3840, 2160), "8K": (7680, 4320), "HD": (1280, 720), "full HD": (1920, 1080)}
    for name, expected in (sizes | {"window": (round(right - left), round(bottom - top))}).items():
        matched.choose("size", name)
        assert size() == expected
    matched.drag("pixels across", 2000)
    matched.drag("pixels down", 1000)
    assert exporter.picture.width == pytest.approx(2000, abs=120)
    matched.type("pixels across", "320")
    matched.type("pixels down", "240")
    assert size() == (320, 240)
    values = {"seconds": (10, 0.5), "fps": (40, 10), "from": (0.5, 0.25), "to": (1.5, 2)}
    for label, (dragged, typed) in (values | {"turntable": (90, -180)}).items():
        matched.drag(label, dragged)
        matched.type(label, f"{typed:g}")
    movie = exporter.movie
    assert (movie.seconds, movie.fps) == (0.5, 10)
    assert (movie.start, movie.end, movie.turntable) == (0.25, 2, -180)
    for suffix in (".npz", ".ply", ".vtu", ".csv"):
        exported(matched, "Save result...", tmp_path / f"match{suffix}")
    again = abfm.load(tmp_path / "match.npz")
    np.testing.assert_array_equal(again.velocity, matched.session.result.velocity)
    with (tmp_path / "match.csv").open() as table:
        assert len(list(csv.reader(table))) == 1 + len(again.energy_history)
    for suffix in (".ply", ".vtu"):
        assert (tmp_path / f"match{suffix}").stat().st_size > 10_000


def save_pictures(small, tmp_path):
    """Save pictures with and without background, and cancel a movie."""
    exported(small, "Save picture...", tmp_path / "plain.png")
    plain = Image.open(tmp_path / "plain.png")
    assert plain.size == (320, 240)
    assert np.asarray(plain.convert("RGB"), dtype=float).std() > 5
    small.check("transparent")
    small.check("color bar", False)
    exported(small, "Save picture...", tmp_path / "bare.png")
    alpha = np.asarray(Image.open(tmp_path / "bare.png").convert("RGBA"))[:, :, 3]
    assert alpha.min() == 0
    assert alpha.max() == 255
    small.type("seconds", "20")
    small.click("Save movie...")
    small.type("file name", "long.mp4")
    small.wait(lambda _: small.window.exporter.running)
    small.click("Cancel export")
    small.wait(lambda _: not small.window.exporter.running)
    assert not (tmp_path / "long.mp4").exists()


def save_movies(small, tmp_path):
    for suffix in (".gif", ".mp4"):
        movie_path = tmp_path / f"movie_path{suffix}"
        exported(small, "Save movie...", movie_path)
        with av.open(movie_path) as movie:
            frames = [frame.to_ndarray(format="rgb24") for frame in movie.decode(video=0)]
        assert len(frames) == 5
        assert frames[0].shape == (240, 320, 3)
        assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 0.5

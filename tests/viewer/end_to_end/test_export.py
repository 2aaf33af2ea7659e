import csv

import av
import numpy as np
import pytest
from PIL import Image

import abfm
from abfm_viewer.files.preferences import with_stored
from abfm_viewer.panels.export import TITLE
from abfm_viewer.session.saving.export_settings import SHOWN_VIEWS, ExportSettings

WINDOW = (640, 600)  # high enough for a tab below a verdict with a warning


def exported(gui, name, path):
    """Press the button of a format, choose a file, and wait until it is written."""
    gui.click(f"{name}...")
    gui.click(name, within=TITLE)
    gui.click("Save as...")
    gui.type("file name", path.name, enter=False)
    gui.click("Save")
    gui.wait(lambda _: path.exists() and not gui.window.exporter.running, 60)
    assert not gui.window.exporter.failed, gui.window.exporter.message
    gui.click("Close", within=TITLE)


def test_tour_of_export(matched, tmp_path):
    """All settings of the dialog are used for small pictures, short movies and data."""
    set_size_and_save_results(matched, tmp_path)
    save_movies(matched, tmp_path)
    save_pictures(matched, tmp_path)


def set_size_and_save_results(matched, tmp_path):
    exporter, (left, top, right, bottom) = matched.window.exporter, matched.window.parts.scene

    def size():
        return exporter.settings.width, exporter.settings.height

    matched.session.player.playing = True
    matched.click("Picture...")
    assert not matched.session.player.playing
    sizes = {"4K": (3840, 2160), "8K": (7680, 4320), "HD": (1280, 720), "full HD": (1920, 1080)}
    for name, expected in (sizes | {"window": (round(right - left), round(bottom - top))}).items():
        matched.choose("size", name)
        assert size() == expected
    matched.drag("pixels across", 2000)
    matched.drag("pixels down", 1000)
    assert exporter.settings.width == pytest.approx(2000, abs=120)
    matched.type("pixels across", "320")
    matched.type("pixels down", "240")
    assert size() == (320, 240)
    matched.drag("dpi", 200)
    matched.type("dpi", "160")
    assert exporter.settings.picture_text == "320 x 240 pixels, printed 5.1 x 3.8 cm at 160 dpi"
    for view in SHOWN_VIEWS:
        matched.choose("view", view)
    matched.choose("view", "best")
    row = matched.search.find("Picture", TITLE).rect
    matched.click("Movie", within=TITLE)
    matched.frames(2)
    assert matched.search.find("Picture", TITLE).rect == row  # the formats stay in their place
    values = {"seconds": (10, 0.5), "fps": (40, 10), "from": (0.5, 0.25), "to": (1.5, 2)}
    for label, (dragged, typed) in (values | {"turntable": (1, -0.5)}).items():
        matched.drag(label, dragged)
        matched.type(label, f"{typed:g}")
    settings = exporter.settings
    assert (settings.seconds, settings.fps, settings.frames) == (0.5, 10, 5)
    assert (settings.start, settings.end, settings.turns) == (0.25, 2, -0.5)
    matched.click("Close", within=TITLE)
    for suffix in (".npz", ".ply", ".vtu", ".csv"):
        exported(matched, "Match data", tmp_path / f"match{suffix}")
    assert with_stored(ExportSettings(), matched.window.preferences.now.export) == exporter.settings
    again = abfm.load(tmp_path / "match.npz")
    np.testing.assert_array_equal(again.velocity, matched.session.result.velocity)
    with (tmp_path / "match.csv").open() as table:
        assert len(list(csv.reader(table))) == 1 + len(again.energy_history)
    for suffix in (".ply", ".vtu"):
        assert (tmp_path / f"match{suffix}").stat().st_size > 10_000
    exported(matched, "Page for a browser", tmp_path / "match.html")
    exported(matched, "Table: path", tmp_path / "path.csv")


def save_pictures(small, tmp_path):
    """Save pictures with each background, and cancel a movie."""
    small.session.set_appearance(theme="dark")
    exported(small, "Picture", tmp_path / "plain.png")
    plain = Image.open(tmp_path / "plain.png")
    assert plain.size == (320, 240)
    assert plain.info["dpi"] == pytest.approx((160, 160), abs=0.1)
    assert np.asarray(plain)[0, 0].max() < 100
    small.click("Picture...")
    small.check("colour bar", False)
    small.choose("background", "white")
    small.click("Close", within=TITLE)
    exported(small, "Picture", tmp_path / "white.png")
    white = np.asarray(Image.open(tmp_path / "white.png"))
    assert white.shape == (240, 320, 3)
    assert (white[0, 0] == 255).all()
    small.click("Picture...")
    small.choose("background", "theme")
    small.choose("background", "transparent")
    small.click("Close", within=TITLE)
    exported(small, "Picture", tmp_path / "bare.png")
    alpha = np.asarray(Image.open(tmp_path / "bare.png").convert("RGBA"))[:, :, 3]
    assert alpha.min() == 0
    assert alpha.max() == 255
    small.click("Movie...")
    small.type("seconds", "20")
    small.click("Save as...")
    small.choose("Recent folders", str(tmp_path))
    small.type("file name", "long.mp4")
    small.wait(lambda _: small.window.exporter.running)
    small.click("Cancel export", within=TITLE)
    small.wait(lambda _: not small.window.exporter.running)
    assert not (tmp_path / "long.mp4").exists()


def save_movies(small, tmp_path):
    for suffix in (".gif", ".mp4"):
        movie_path = tmp_path / f"movie_path{suffix}"
        small.click("Movie...")
        small.choose("file type", suffix)
        small.click("Close", within=TITLE)
        exported(small, "Movie", movie_path)
        with av.open(movie_path) as movie:
            frames = [frame.to_ndarray(format="rgb24") for frame in movie.decode(video=0)]
        assert len(frames) == 5
        assert frames[0].shape == (240, 320, 3)
        assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 0.5

"""From launch to a saved movie in a real window, with a real mouse and keyboard."""

from __future__ import annotations

import shutil
import sys

import av
import pytest

from abfm.assets import asset_path
from tests.viewer.window.real_window import opened

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Xvfb is Linux's")


def test_from_launch_to_a_saved_movie(tmp_path):
    for program in ("Xvfb", "xdotool"):
        assert shutil.which(program), (
            f"{program} is missing; ./run test installs it, or apt-get install xvfb xdotool"
        )
    film = tmp_path / "a film.mp4"
    with opened(asset_path("eight.off"), tmp_path) as window:
        window.click("Match", "button")  # not the tab
        window.menu("File", "Export movie...")
        window.find("Save result...", seconds=120)  # when there is a result
        for label, number in (
            ("pixels across", 480),
            ("pixels down", 320),
            ("seconds", 1),
            ("fps", 12),
        ):
            window.type(label, str(number), within="Export")
        window.click("Save movie...")
        window.type("folder", str(tmp_path))
        window.type("file name", film.name, enter=False)
        window.click("Save")
        window.until(film.exists, "saves no movie", 120)
        window.key("ctrl+q")
        window.click("Don't save")
        window.app.wait(30)
    assert window.app.returncode == 0, (tmp_path / "log.txt").read_text()
    assert (tmp_path / "log.txt").read_text() == ""
    with av.open(film) as movie:
        frames = [frame.to_ndarray(format="rgb24") for frame in movie.decode(video=0)]
    assert len(frames) == 12
    assert frames[0].shape == (320, 480, 3)
    assert abs(frames[0].astype(int) - frames[-1]).mean() > 0.5  # the function moved

"""From launch to a saved movie in a real window, with a real mouse and keyboard."""

from __future__ import annotations

import shutil
import sys

import pytest

from abfm.assets import asset_path
from tests.viewer.real_window import opened

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Xvfb is Linux's")


def test_from_launch_to_a_saved_movie(tmp_path):
    for program in ("Xvfb", "xdotool"):
        assert shutil.which(program), f"{program} is missing; ./run test installs it, or apt-get install xvfb xdotool"
    with opened(asset_path("eight.off"), tmp_path) as window:
        window.click("Match")
        window.find("Match", seconds=120)
        window.key("ctrl+q")
        window.click("Don't save")
        window.app.wait(30)
    assert window.app.returncode == 0, (tmp_path / "log.txt").read_text()
    assert (tmp_path / "log.txt").read_text() == ""

"""Pictures of the window in its main states, compared with those in tests/snapshots."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from abfm_viewer.automation import Driver
from abfm_viewer.session import notices
from tests.viewer.end_to_end.likeness import difference
from tests.viewer.sessions import EGG

SNAPSHOTS = Path(__file__).parents[2] / "snapshots"


def compared(gui, name, folder, update):
    """What is different between the window and a snapshot, which may be written anew."""
    gui.wait(lambda s: not gui.window.shown.busy and not s.notices.latest.text)
    gui.frames(5)
    actual, expected = folder / name, SNAPSHOTS / name
    gui.screenshot(actual)
    assert not gui.errors
    left, top, right, bottom = gui.window.parts.status
    frames_per_second = ((left + right) / 2, top, right, bottom)
    found = (
        difference(actual, expected, [frames_per_second]) if expected.exists() else "there was none"
    )
    if update and found:
        shutil.copy(actual, expected)
    return "" if update else found


def test_the_window_in_its_main_states(tmp_path, request, monkeypatch):
    """One walk through the app: every picture shows what the steps before it left."""
    monkeypatch.setattr(notices, "_SECONDS_OF_NOTICE", 0.5)
    found, seen = [], []
    with Driver(EGG, size=(1280, 800)) as gui:

        def check(name):
            seen.append(name)
            found.append(
                compared(gui, name, tmp_path, request.config.getoption("--update-snapshots"))
            )

        # it depends on the machine's speed
        gui.session.editor.amend(view=replace(gui.session.view, flow_after_match=False))
        check("start.png")
        gui.click("Match")
        gui.wait(lambda s: s.solver.finished)
        check("matched.png")
        gui.window.ui.open_tab = "Match"
        check("energy.png")
        gui.check("arrows")
        gui.window.ui.open_tab = "Look"
        check("arrows.png")
        gui.check("arrows", False)
        gui.check("linear blend")
        gui.check("error")
        gui.window.ui.open_tab = "Look"
        check("compare.png")
        gui.check("linear blend", False)
        gui.check("error", False)
        gui.menu("View", "Layout", "column")
        check("column.png")
        gui.menu("View", "Layout", "row")
        gui.window.ui.open_tab = "Match"
        gui.menu("View", "Dark theme")
        check("dark.png")
        gui.key("f1")
        check("shortcuts.png")
    assert "".join(found) == ""
    assert sorted(path.name for path in SNAPSHOTS.iterdir()) == sorted(seen)


@pytest.mark.parametrize("change", ["panel", "colors", "word", "shift"])
def test_the_comparison_notices_what_matters(tmp_path, change):
    expected, actual = SNAPSHOTS / "matched.png", tmp_path / "changed.png"
    picture = Image.open(expected).convert("RGB")
    if change == "panel":
        ImageDraw.Draw(picture).rectangle((900, 30, 1280, 770), fill=picture.getpixel((5, 300)))
    elif change == "colors":
        picture = Image.fromarray(np.asarray(picture)[:, :, ::-1].copy())
    elif change == "word":
        ImageDraw.Draw(picture).rectangle((900, 32, 1270, 56), fill=picture.getpixel((905, 60)))
    else:
        picture = picture.transform(picture.size, Image.Transform.AFFINE, (1, 0, 12, 0, 1, 0))
    picture.save(actual)
    assert "differs from" in difference(actual, expected)
    assert (tmp_path / "changed-difference.png").exists()


def test_the_comparison_overlooks_what_does_not(tmp_path):
    expected, actual = SNAPSHOTS / "matched.png", tmp_path / "noisy.png"
    pixels = np.asarray(Image.open(expected).convert("RGB"), dtype=int)
    noise = np.random.default_rng(0).integers(-2, 3, pixels.shape)
    Image.fromarray(np.clip(pixels + noise, 0, 255).astype(np.uint8)).save(actual)
    assert difference(actual, expected) == ""
    assert "shape" in difference(_cropped(actual), expected)


def _cropped(path):
    Image.open(path).crop((0, 0, 640, 400)).save(path)
    return path

"""Pictures of the window in its main states, compared with those in tests/snapshots."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from abfm_viewer.automation import Driver
from abfm_viewer.session import notices
from tests.viewer.sessions import EGG, match

SNAPSHOTS = Path(__file__).parents[2] / "snapshots"
_BLOCK = 40  # pixels
_MEAN, _WORST_BLOCK = 1.5, 12.0  # mean absolute differences of 0 to 255


def difference(actual, expected, masked=()):
    """Return a description of the relevant difference; empty if there is none.

    The picture of the difference is written next to the actual one. Each block is compared, so that
    small differences count, such as a missing word or button.
    """
    pictures = [np.asarray(Image.open(path).convert("RGB"), float) for path in (actual, expected)]
    if pictures[0].shape != pictures[1].shape:
        return f"{actual} has shape {pictures[0].shape}, expected {pictures[1].shape} as {expected}"
    apart = np.abs(pictures[0] - pictures[1]).mean(axis=2)
    for left, top, right, bottom in masked:
        apart[int(top) : int(bottom) + 1, int(left) : int(right) + 1] = 0
    height, width = (size // _BLOCK * _BLOCK for size in apart.shape)
    blocks = apart[:height, :width].reshape(height // _BLOCK, _BLOCK, -1, _BLOCK).mean(axis=(1, 3))
    row, column = np.unravel_index(np.argmax(blocks), blocks.shape)
    if apart.mean() <= _MEAN and blocks.max() <= _WORST_BLOCK:
        return ""
    where = actual.with_name(f"{actual.stem}-difference.png")
    Image.fromarray(np.clip(4 * apart, 0, 255).astype(np.uint8)).save(where)
    place = f"x={column * _BLOCK}, y={row * _BLOCK}"
    return (
        f"{actual} differs from {expected}: by {apart.mean():.2f} on average (at most {_MEAN}), "
        f"and by {blocks.max():.1f} around {place} (at most {_WORST_BLOCK}); see {where}. "
        "If it is better so: pytest --update-snapshots"
    )


def compared(gui, name, folder, update):
    """Return the difference between the window and a snapshot, which may be updated."""
    shown = gui.window.shown
    gui.frames(2)
    gui.wait(lambda s: not shown.busy and not s.notices.latest.text)
    gui.wait(lambda _: not shown.quantities.busy)
    gui.frames(5)
    actual, expected = folder / name, SNAPSHOTS / name
    gui.screenshot(actual)
    assert not gui.errors
    left, top, right, bottom = gui.window.parts.status
    frames_per_second = ((left + right) / 2, top, right, bottom)
    found = "there was none"
    if expected.exists():
        found = difference(actual, expected, [frames_per_second])
    if update and found:
        shutil.copy(actual, expected)
    return "" if update else found


def test_window_equals_snapshots(tmp_path, request, monkeypatch):
    """One walk through the app; every picture depends on the steps before it."""
    monkeypatch.setattr(notices, "_NOTICE_SECONDS", 0.5)
    found, seen = [], []
    with Driver(EGG, size=(1280, 800)) as gui:

        def check(name):
            seen.append(name)
            update = request.config.getoption("--update-snapshots")
            found.append(compared(gui, name, tmp_path, update))

        # this text depends on the speed of the machine
        gui.session.editor.amend(view=replace(gui.session.view, flow_after_match=False))
        check("start.png")
        match(gui)
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
    assert sorted(path.name for path in SNAPSHOTS.glob("*.png")) == sorted(seen)


@pytest.mark.parametrize("change", ["panel", "colors", "word", "shift"])
def test_comparison_detects_relevant_changes(tmp_path, change):
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


def test_comparison_ignores_small_changes(tmp_path):
    expected, actual = SNAPSHOTS / "matched.png", tmp_path / "noisy.png"
    pixels = np.asarray(Image.open(expected).convert("RGB"), dtype=int)
    noise = np.random.default_rng(0).integers(-2, 3, pixels.shape)
    Image.fromarray(np.clip(pixels + noise, 0, 255).astype(np.uint8)).save(actual)
    assert difference(actual, expected) == ""
    Image.open(actual).crop((0, 0, 640, 400)).save(actual)
    assert "shape" in difference(actual, expected)

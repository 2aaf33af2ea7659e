"""Pictures of the window in its main states, compared with those in tests/snapshots."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from abfm_viewer.automation import Driver
from tests.viewer.end_to_end.conftest import EGG
from tests.viewer.end_to_end.likeness import difference

SNAPSHOTS = Path(__file__).parents[2] / "snapshots"


@pytest.fixture(scope="module")
def matched():
    """One window for all states, which build on each other in the order of the tests."""
    with Driver(EGG, size=(1280, 800)) as gui:
        yield gui


@pytest.fixture
def check(matched, tmp_path, request):
    """Compares the window with a snapshot, or writes it."""

    def compare(name):
        matched.wait(lambda s: not matched.window.shown.busy and not s.notice.text)
        matched.frames(5)
        actual, expected = tmp_path / name, SNAPSHOTS / name
        matched.screenshot(actual)
        assert not matched.errors
        if request.config.getoption("--update-snapshots"):
            SNAPSHOTS.mkdir(exist_ok=True)
            shutil.copy(actual, expected)
        assert expected.exists(), f"there is no {expected}: pytest --update-snapshots writes it"
        left, top, right, bottom = matched.window.parts.status
        frames_per_second = ((left + right) / 2, top, right, bottom)
        assert difference(actual, expected, [frames_per_second]) == ""

    return compare


def test_start(check):
    check("start.png")


def test_after_a_match(matched, check):
    matched.click("Match")
    matched.wait(lambda s: s.solver.finished)
    check("matched.png")


def test_energy_plot(matched, check):
    matched.window.ui.show_section("Energy")
    check("energy.png")


def test_field_arrows(matched, check):
    matched.check("arrows")
    matched.window.ui.show_section("Field")
    check("arrows.png")
    matched.check("arrows", False)


def test_comparison(matched, check):
    matched.check("linear blend")
    matched.check("error")
    matched.window.ui.show_section("Compare")
    check("compare.png")
    matched.check("linear blend", False)
    matched.check("error", False)


def test_column_layout(matched, check):
    matched.menu("View", "Layout", "column")
    check("column.png")
    matched.menu("View", "Layout", "row")


def test_dark_theme(matched, check):
    matched.window.ui.show_section("Parameters")
    matched.menu("View", "Dark theme")
    check("dark.png")


def test_dialog(matched, check):
    matched.key("f1")
    check("shortcuts.png")
    matched.key("esc")


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

"""The menu Samples: bundled meshes and the paper's figures, each with a picture."""

from __future__ import annotations

import polyscope.imgui as imgui

from abfm.assets import asset_path
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.samples import vertices
from abfm_viewer.document.samples import FIGURE_SAMPLES, SAMPLES, Sample
from abfm_viewer.scene.sample_textures import SampleTextures
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.widgets.toolkit import Ui

_WIDTH, _HEIGHT = 420, 50
_FEWEST, _MOST = 2, 4  # columns
_SHARE = 0.86  # of the window's height that the menu may take


def draw(ui: Ui, files: SessionFiles, textures: SampleTextures) -> None:
    """Draw what the menu shows when it is open: as low as the window asks for, and as many columns as that takes."""
    display = imgui.GetIO().DisplaySize
    spacing, line = imgui.GetStyle().ItemSpacing, imgui.GetTextLineHeight()
    columns = _FEWEST
    while (height := _height(columns, display[1], spacing[1], line)) < line and columns < _MOST:
        columns += 1
    width = min(ui.px(_WIDTH), 0.92 * display[0] / columns - spacing[0])
    size = (width, max(min(height, ui.px(_HEIGHT)), line))
    for heading, part in (("Meshes", SAMPLES), ("Figures of the paper", FIGURE_SAMPLES)):
        ui.heading(heading)
        for number, sample in enumerate(part):
            if number % columns:
                ui.beside()
            if _entry(ui, sample, files.sample == sample.name, size, textures):
                files.open_figure(sample.figure) if sample.figure else files.open(asset_path(sample.name))


def _height(columns: int, room: float, spacing: float, line: float) -> float:
    """What the entries may be high, below their two headings."""
    rows = sum(-(-len(part) // columns) for part in (SAMPLES, FIGURE_SAMPLES))
    return float((_SHARE * room - 2 * (line + spacing)) / rows - spacing)


def _entry(ui: Ui, sample: Sample, loaded: bool, size: tuple[float, float], textures: SampleTextures) -> bool:
    """Draw a sample's picture, name, size and what it is about; whether it was chosen."""
    left, top = imgui.GetCursorScreenPos()
    chosen = ui.tile(sample.name, loaded, size)
    count = f"{vertices()[sample.name]:,} vertices"
    ui.tip(f"{sample.name}, {count}{', loaded' if loaded else ''}: {sample.about}")
    draw_list, side = imgui.GetWindowDrawList(), size[1]
    if (found := textures.find(sample.name)) is not None:
        texture, first, second = found
        draw_list.AddImage(texture, (left, top), (left + side, top + side), first, second)
    line, x = imgui.GetTextLineHeight(), left + side + ui.px(8)
    room = left + size[0] - x
    mark = "  (loaded)" if loaded else ""
    lines = [f"{sample.name}, {count}{mark}", sample.about][: max(int(size[1] / line), 1)]
    y = top + (size[1] - len(lines) * line) / 2
    for text, color in zip(lines, (ui.colors.ink, ui.colors.muted), strict=False):
        shown = cut(text, room, lambda text: float(imgui.CalcTextSize(text)[0]))
        draw_list.AddText((x, y), imgui.ColorConvertFloat4ToU32(color), shown)
        y += line
    return chosen

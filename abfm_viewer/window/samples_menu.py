"""The menu Samples: bundled meshes and the paper's figures, each with a picture."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import polyscope.imgui as imgui
from PIL import Image

from abfm.assets import asset_path
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.samples import PICTURES, part, vertices
from abfm_viewer.document.samples import FIGURE_SAMPLES, SAMPLES, Sample
from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.widgets.popups import tile
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window.figure_document import figure_document

_WIDTH, _HEIGHT = 420, 50
_FEWEST, _MOST = 2, 4  # columns
_SHARE = 0.86  # of the window's height that the menu may take

_PICTURES = "pictures of the samples"
Corner = tuple[float, float]


class SampleTextures:
    """The pictures, loaded when they are first asked for, and again when polyscope forgot them."""

    def __init__(self) -> None:
        self._buffer: Any = None

    def find(self, name: str) -> tuple[imgui.ImTextureRef, Corner, Corner] | None:
        """A texture, and where in it a sample's picture is; None where nothing is drawn."""
        if ps.get_render_engine_backend_name() == "openGL_mock":
            return None
        if not self._is_there():
            pixels = np.asarray(Image.open(PICTURES).convert("RGBA"), dtype=np.float32) / 255
            ps.add_color_alpha_image_quantity(_PICTURES, pixels, enabled=False)
            self._buffer = ps.get_quantity_buffer(_PICTURES, "colors")
        return imgui.ImTextureRef(int(self._buffer.get_texture_native_id())), *part(name)

    def _is_there(self) -> bool:
        if self._buffer is None:
            return False
        try:
            self._buffer.check_ref_still_valid()
        except ValueError:
            return False
        return True


def draw(ui: Ui, files: SessionFiles, textures: SampleTextures) -> None:
    """Draw what the open menu shows, as low and in as many columns as the window asks for."""
    display = imgui.GetIO().DisplaySize
    spacing, line = imgui.GetStyle().ItemSpacing, imgui.GetTextLineHeight()
    columns = _FEWEST
    while (height := _height(columns, display[1], spacing[1], line)) < line and columns < _MOST:
        columns += 1
    width = min(ui.px(_WIDTH), 0.92 * display[0] / columns - spacing[0])
    size = (width, max(min(height, ui.px(_HEIGHT)), line))
    for heading, samples in (("Meshes", SAMPLES), ("Figures of the paper", FIGURE_SAMPLES)):
        ui.heading(heading)
        for number, sample in enumerate(samples):
            if number % columns:
                ui.beside()
            if _entry(ui, sample, files.sample == sample.name, size, textures):
                _open(files, sample)


def _open(files: SessionFiles, sample: Sample) -> None:
    if sample.figure:
        files.open_made(f"figure {sample.figure}", partial(figure_document, sample.figure))
    else:
        files.open(asset_path(sample.name))


def _height(columns: int, room: float, spacing: float, line: float) -> float:
    """Return how high the entries may be, below their two headings."""
    rows = sum(-(-len(part) // columns) for part in (SAMPLES, FIGURE_SAMPLES))
    return float((_SHARE * room - 2 * (line + spacing)) / rows - spacing)


def _entry(
    ui: Ui, sample: Sample, loaded: bool, size: tuple[float, float], textures: SampleTextures
) -> bool:
    """Draw a sample's picture, name, size and what it is about; whether it was chosen."""
    left, top = imgui.GetCursorScreenPos()
    chosen = tile(ui, sample.name, loaded, size)
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
        shown = cut(text, room, ui.text_width)
        draw_list.AddText((x, y), imgui.ColorConvertFloat4ToU32(color), shown)
        y += line
    return chosen

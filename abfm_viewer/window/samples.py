"""The menu Samples: bundled meshes and figures of the paper, each with a thumbnail."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import polyscope.imgui as imgui
from PIL import Image

import abfm
from abfm import AbfmError, experiments, load_mesh
from abfm.assets import asset_path
from abfm.parameters import FIGURES, TITLES
from abfm.types import FloatArray
from abfm.wording import capital
from abfm_viewer.appearance import samples as bundled
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.document.document import Channel, Surface, View
from abfm_viewer.document.kinds import MatchDocument, PairDocument
from abfm_viewer.scene.textures import Textures
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window.wave import fsaverage5, wave_document

# size of a menu entry, in pixels at a scale of 1
_WIDTH = 420
_HEIGHT = 50
_COLUMNS_MIN = 2
_COLUMNS_MAX = 5
_HEIGHT_SHARE_MAX = 0.86  # maximum height of the menu, relative to the window
_PICTURES = "pictures of the samples"
_VIEW_OF_FIGURE: dict[int, dict[str, Any]] = {
    1: {"blend": True},
    2: {"streaks": True},
    5: {"streaks": True, "part": "commuting"},
    # faded, because the field is only noise where it is almost 0
    6: {"streaks": True, "fade": True, "part": "pushed gradient"},
    8: {"error": True},
}
"""Settings of `View` by figure, which show what the figure is about, such as its field."""
_ON_THE_HUMANS = Channel("gaussian:vertex=145,width=0.18", "gaussian:vertex=700,width=0.18")


def figure_document(figure: int, view: View) -> tuple[MatchDocument, dict[str, FloatArray]]:
    """Return a document of a figure of the paper, and values of functions without a spec.

    A subprocess computes the example, which takes seconds.
    """
    example, given = experiments.example_in_subprocess(figure)
    parameters = example.problem.parameters
    document = MatchDocument(
        (Surface(example.problem.mesh, example.name),),
        tuple(Channel(source, target) for source, target in example.specs),
        parameters=parameters,
        result=given,
        time=parameters.tau if given else 0.0,
        view=replace(view.preferences, **_VIEW_OF_FIGURE.get(figure, {})),
    )
    return document, example.values


def pair_document(name: str, view: View) -> tuple[PairDocument, dict[str, FloatArray]]:
    """Return a document of two bundled meshes, named ``A to B``, with a function on each."""
    if name == bundled.CORTEX:
        return cortex_document(view)
    a, b = name.split(" to ")
    surfaces = (Surface(load_mesh(asset_path(one)), one) for one in (a, b))
    return PairDocument(tuple(surfaces), (_ON_THE_HUMANS,), view=view.preferences), {}


def cortex_document(view: View) -> tuple[PairDocument, dict[str, FloatArray]]:
    """Return both hemispheres of fsaverage5 as spheres with sulcal depth, the left one mirrored.

    Raises `AbfmError` without nilearn, which contains them.
    """
    if (folder := fsaverage5()) is None:
        raise AbfmError("this sample needs fsaverage5 of nilearn; run: pip install 'abfm[brain]'")
    surfaces, specs = [], []
    for side in ("left", "right"):
        mesh = load_mesh(folder / f"sphere_{side}.gii.gz")
        surfaces.append(Surface(mesh, f"{side} cortex"))
        specs.append(str(abfm.functions.ValuesFile(path=str(folder / f"sulc_{side}.gii.gz"))))
    depth = Channel(specs[0], specs[1])
    return PairDocument(
        tuple(surfaces), (depth,), initial="sphere:mirror", view=view.preferences
    ), {}


def _population(folder: Path) -> Path:
    # imported late, because it loads the solver
    from abfm_viewer.window.population_sample import made_in_subprocess

    return made_in_subprocess(folder)


@cache
def _pictures() -> Image.Image:
    return Image.open(bundled.PICTURES)


def draw(ui: Ui, files: SessionFiles, textures: Textures) -> None:
    """Draw the entries of the menu Samples, in columns that fit the window."""
    display = imgui.GetIO().DisplaySize
    spacing, line = imgui.GetStyle().ItemSpacing, imgui.GetTextLineHeight()
    figures = {f"Figure {n}": capital(TITLES[n]) for n in FIGURES}
    meshes = bundled.MESHES | bundled.PAIRS | bundled.SEQUENCES | bundled.POPULATIONS
    parts = {"Meshes": meshes, "Figures of the paper": figures}
    headings = len(parts) * (line + spacing[1])
    available = _HEIGHT_SHARE_MAX * display[1] - headings
    columns, height = _COLUMNS_MIN - 1, 0.0
    while height < line and columns < _COLUMNS_MAX:
        columns += 1
        rows = sum(-(-len(part) // columns) for part in parts.values())
        height = available / rows - spacing[1]
    width = min(ui.px(_WIDTH), 0.92 * display[0] / columns - spacing[0])
    size = (width, max(min(height, ui.px(_HEIGHT)), line))
    for heading, samples in parts.items():
        ui.heading(heading)
        for number, (name, description) in enumerate(samples.items()):
            if number % columns:
                ui.same_line()
            if not _is_chosen(ui, (name, description), files.sample == name, size, textures):
                continue
            if name in bundled.MESHES:
                files.open(asset_path(name))
            elif name == bundled.WAVE:
                files.open_made(name.lower(), lambda view: (wave_document(view.preferences), {}))
            elif name in bundled.POPULATIONS:
                files.open_made_table(name, _population)
            elif name in bundled.PAIRS:
                files.open_made(name, partial(pair_document, name))
            else:
                files.open_made(name.lower(), partial(figure_document, int(name.split()[1])))


def _is_chosen(
    ui: Ui, sample: tuple[str, str], loaded: bool, size: tuple[float, float], textures: Textures
) -> bool:
    (name, description), (left, top) = sample, imgui.GetCursorScreenPos()
    flags = imgui.ImGuiSelectableFlags_None
    chosen = bool(imgui.Selectable(f"##{name}", loaded, flags, size))
    is_wanted = ui.record_item(name, "item", text="checked" if loaded else "")
    # a sample of two surfaces has the thumbnail of B
    pictured = name if name in bundled.vertices() else name.split(" to ")[-1]
    pictured = bundled.PICTURE_SOURCES.get(name, pictured)
    size_text = f", {bundled.vertices()[name]:,} vertices" if pictured == name else ""
    title = f"{name}{size_text}{', loaded' if loaded else ''}"
    ui.tip(f"{title}: {description}")
    draw_list, side = imgui.GetWindowDrawList(), size[1]
    if (texture := textures.find(_PICTURES, _pictures())) is not None:
        first, second = bundled.thumbnail_corners(pictured)
        draw_list.AddImage(texture, (left, top), (left + side, top + side), first, second)
    line, x = imgui.GetTextLineHeight(), left + side + ui.px(8)
    available = left + size[0] - x
    title = next((each for each in (title, name) if ui.text_width(each) <= available), name)
    texts = [title, description][: max(int(side / line), 1)]
    y = top + (side - len(texts) * line) / 2
    for text, color in zip(texts, (ui.colors.ink, ui.colors.muted), strict=False):
        shown = abbreviated(text, available, ui.text_width)
        draw_list.AddText((x, y), imgui.ColorConvertFloat4ToU32(color), shown)
        y += line
    return chosen or is_wanted

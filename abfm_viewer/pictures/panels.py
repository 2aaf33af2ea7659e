"""Panels of a sheet: colour ranges, cameras and pictures."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from PIL import Image

from abfm.calculus.operators import face_areas, vertex_areas
from abfm.calculus.speeds import fast_speed
from abfm.io.sheets import Checker, Coordinates, Panel, Sheet, Streaks, Values
from abfm.mesh import TriangleMesh
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange, place_colors
from abfm.pages.front import Front, front_of, triple
from abfm.streaks.line_integral import line_integral_convolution
from abfm.types import FloatArray
from abfm_viewer.pictures.canvas import canvas, rendered
from abfm_viewer.scene import opengl, overlays
from abfm_viewer.scene.surfaces import Camera, fitted, register, set_camera, show
from abfm_viewer.shown.arrows import ArrowStyle, arrow_spacing, arrows_of
from abfm_viewer.shown.colored_values import ColoredValues
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.paint import Paint, PaintKind
from abfm_viewer.shown.ribbons import unit
from abfm_viewer.shown.streak_texture import streak_texture

_INK = (0.1, 0.1, 0.12)
# colours of points, in linear light
POINT_COLORS = (
    (1.0, 0.45, 0.0),
    (0.45, 0.1, 0.75),
    (0.0, 0.5, 0.25),
    (0.85, 0.0, 0.45),
    (0.0, 0.4, 0.8),
)
_RIM = (1.0, 1.0, 1.0)
_ARROW_LENGTH_MAX = 0.12  # in sqrt(area)
_ARROW_DENSITY = 0.15
_POINT_RADIUS = 0.022  # in sqrt(area)
_LINE_HALF_WIDTH = 0.005  # in sqrt(area)
_TEXELS = 2048
_SQUARE_SIZE = 0.5  # of a checkerboard, in its coordinates
CLAMP_SHARE = 0.1
"""Share of a colour range by which values may exceed it before a caption notes it.

Advection overshoots by a few percent even if it is correct, which is not visible in the colours.
"""


def cameras(
    sheet: Sheet, aspects: tuple[float, float] = (0.0, math.inf)
) -> dict[TriangleMesh, Camera]:
    """Return a camera for each mesh, which shows its source and target well.

    Its aspect (width over height) is that of the mesh, within the limits ``aspects``.
    """
    fronts: dict[TriangleMesh, Front] = {}
    for panel in _panels(sheet):
        if fronts and sheet.one_view:
            fronts.setdefault(panel.mesh, next(iter(fronts.values())))
        elif panel.mesh not in fronts:
            ends = [one for one in _panels(sheet) if one.frame in ("source", "target")]
            functions = [_function(one)[1] for one in ends if one.mesh is panel.mesh]
            count = len(panel.mesh.vertices)
            on_vertices = [f for f in functions if f is not None and len(f) == count]
            shown = sheet.view_functions if not fronts and sheet.view_functions else on_vertices
            fronts[panel.mesh] = front_of(panel.mesh, *shown, view=sheet.view)
    found = {}
    for mesh, front in fronts.items():
        free = fitted(mesh.vertices, front)
        aspect = min(max(free.aspect, aspects[0]), aspects[1])
        found[mesh] = fitted(mesh.vertices, front, aspect)
    return found


def panel_pictures(
    sheet: Sheet,
    sizes: Sequence[tuple[int, int]],
    ranges: Mapping[str, ColorRange],
    views: Mapping[TriangleMesh, Camera],
) -> list[Image.Image]:
    """Return a picture of each panel of a sheet on a transparent background.

    ``sizes`` are widths and heights in pixels, ``ranges`` are colour ranges by title of the colour
    bar, ``views`` are the cameras of the meshes.
    """
    pictures: dict[int, Image.Image] = {}
    fast = _fast_speeds(sheet)
    for size in dict.fromkeys(sizes):  # one canvas for each size
        with canvas(*size):
            for number, panel in enumerate(_panels(sheet)):
                if sizes[number] == size:
                    _draw(panel, ranges, views[panel.mesh], size[1], fast.get(panel.mesh, 0.0))
                    pictures[number] = Image.fromarray(rendered(transparent=True))
    return [pictures[number] for number in range(len(sizes))]


def _fast_speeds(sheet: Sheet) -> dict[TriangleMesh, float]:
    """Return the speed of the longest arrows on each mesh, the same for all its panels."""
    found = defaultdict[TriangleMesh, float](float)
    for panel in _panels(sheet):
        if panel.arrows is not None:
            speed = np.linalg.norm(panel.arrows, axis=1)
            found[panel.mesh] = max(found[panel.mesh], fast_speed(panel.mesh, speed))
    return found


def _draw(
    panel: Panel, ranges: Mapping[str, ColorRange], view: Camera, height: int, fast: float
) -> None:
    mesh = panel.mesh
    opengl.clear()
    set_camera(view, mesh)
    surface = register("surface", mesh)
    show(surface, mesh, _paint(panel, ranges), square=_SQUARE_SIZE)
    if panel.arrows is not None:
        eye = _eye(view, mesh)
        scale = mesh.length_scale * height / view.height
        spacing = arrow_spacing(_ARROW_DENSITY, scale)
        style = ArrowStyle(_ARROW_LENGTH_MAX, spacing, fast)
        arrows = arrows_of(mesh, panel.arrows, style, eye, panel.determined)
        if len(arrows.spines):
            overlays.draw_arrows("arrows", arrows, _INK, _RIM)
            overlays.show_visible_arrows("arrows", arrows, eye, arrows.hidden(eye))
    if panel.lines:
        paths = [overlays.path_through(mesh, line) for line in panel.lines]
        ribbons = overlays.line_ribbons(paths, _LINE_HALF_WIDTH)
        overlays.draw_ribbons("lines", mesh, ribbons, _INK)
    points = zip(() if panel.points is None else panel.points, cycle(POINT_COLORS))
    for number, (point, color) in enumerate(points):
        overlays.draw_points(f"point {number}", mesh, point[None], color, _POINT_RADIUS)


def _eye(view: Camera, mesh: TriangleMesh) -> Eye:
    towards = np.array(view.position) - view.target
    axes = Front(triple(unit(towards)), view.front.up).axes
    return Eye(axes, np.array(view.position) / mesh.length_scale)


def _paint(panel: Panel, ranges: Mapping[str, ColorRange]) -> Paint:
    mesh, paint, label = panel.mesh, panel.paint, panel.label
    if isinstance(paint, Values):
        on_vertices = len(paint.values) == len(mesh.vertices)
        kind: PaintKind = "vertex values" if on_vertices else "face values"
        return Paint(kind, paint.values, label, ranges[paint.bar])
    if isinstance(paint, Coordinates):
        return Paint("colors", place_colors(mesh.vertices, paint.positions), label)
    if isinstance(paint, Checker):
        return Paint("checker", paint.coordinates, label)
    atlas, image = line_integral_convolution(mesh, paint.velocity, size=_TEXELS)
    found = ranges.get(paint.bar)
    values = None if paint.values is None or found is None else ColoredValues(paint.values, found)
    colors = streak_texture(atlas, image, values)
    return Paint("texture", colors, label, corners=atlas.corner_coordinates)


def _panels(sheet: Sheet) -> list[Panel]:
    return [cell for row in sheet.rows for cell in row if isinstance(cell, Panel)]


def color_ranges(sheet: Sheet) -> dict[str, ColorRange]:
    """Return the colour range of each colour bar, by its title, in the order of first use.

    The range is that of the source and target functions, or else that of all functions. Values
    outside the range have the colour of its nearest end.
    """
    every: dict[str, list[Panel]] = defaultdict(list)
    for panel in _panels(sheet):
        bar, values = _function(panel)
        if values is not None:
            every[bar].append(panel)
    return {bar: _range_of(panels) for bar, panels in every.items()}


def _range_of(panels: Sequence[Panel]) -> ColorRange:
    shown = [one for one in panels if one.frame in ("source", "target")] or panels
    functions, areas = [], []
    for panel in shown:
        _, values = _function(panel)
        assert values is not None
        on_vertices = len(values) == len(panel.mesh.vertices)
        functions.append(values)
        areas.append(vertex_areas(panel.mesh) if on_vertices else face_areas(panel.mesh))
    return color_range(*functions, areas=areas)


def captions(sheet: Sheet) -> list[str]:
    """Return the notes of a sheet, and notes on panels with values outside the colour range."""
    ranges, texts = color_ranges(sheet), list(sheet.notes)
    for panel in _panels(sheet):
        bar, values = _function(panel)
        if values is not None:
            colors, low, high = ranges[bar], float(values.min()), float(values.max())
            shown_low, shown_high = colors.full
            if max(shown_low - low, high - shown_high) > CLAMP_SHARE * (shown_high - shown_low):
                of_bar = "" if bar in ("function", panel.label) else f" ({bar})"
                texts.append(
                    f"Outside the colour range: '{panel.label}'{of_bar} ranges from {low:,.4g} to "
                    f"{high:,.4g}, the colours from {colors.low:,.4g} to {colors.high:,.4g}."
                )
        elif isinstance(panel.paint, Coordinates):
            beyond = _outside(panel.mesh.vertices, panel.paint.positions)
            if beyond > CLAMP_SHARE:
                texts.append(
                    f"Outside the colour range: positions of '{panel.label}' are outside the "
                    f"bounding box, by up to {beyond:,.3g} times its extent."
                )
    return texts


def _function(panel: Panel) -> tuple[str, FloatArray | None]:
    """Return the title of the colour bar and the values of a panel; without values, "" and None."""
    paint = panel.paint
    return (paint.bar, paint.values) if isinstance(paint, Values | Streaks) else ("", None)


def _outside(vertices: FloatArray, positions: FloatArray) -> float:
    """Return the largest distance of positions (V, 3) outside the bounding box of the vertices.

    Each distance is relative to the size of the box in its direction. Sizes below a hundredth of
    the largest size count as that hundredth.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = np.maximum(high - low, 0.01 * (high - low).max())
    return float((np.maximum(low - positions, positions - high) / extent).max())

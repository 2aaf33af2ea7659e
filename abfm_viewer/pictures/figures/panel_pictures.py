"""Pictures of a figure's panels, drawn off the screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PIL import Image

from abfm.experiments.sheet import Checker, Coordinates, Panel, Sheet, Streaks, Values
from abfm.mesh import TriangleMesh
from abfm.streaks.line_integral import line_integral_convolution
from abfm.types import FloatArray
from abfm_viewer.appearance.colormaps import ColorRange, place_colors
from abfm_viewer.pictures.canvas import canvas, drawn
from abfm_viewer.pictures.figures.ranges import panels
from abfm_viewer.scene import marks, viewport
from abfm_viewer.scene.camera import Camera, View, best_view, fitted
from abfm_viewer.scene.drawing_units import drawing_units
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.surface_quantities import register, show_checker, show_colors, show_texture, show_values
from abfm_viewer.shown.streak_texture import streak_texture

NARROWEST, WIDEST = 0.45, 1.9  # width over height of a panel
_INK = (0.1, 0.1, 0.12)
POINT_COLORS = ((1.0, 0.45, 0.0), (0.45, 0.1, 0.75), (0.0, 0.5, 0.25), (0.85, 0.0, 0.45), (0.0, 0.4, 0.8))
"""Colours of marked points, in linear light."""
_ARROW_LENGTH, _ARROW_DENSITY = 0.12, 0.3
_POINT, _LINE = 0.022, 0.005  # radii, of sqrt(area)
_TEXELS = 2048
_HALF = 0.5  # side of a checkerboard's field in its unit


def cameras(sheet: Sheet) -> dict[TriangleMesh, Camera]:
    """One camera for each mesh, that shows what the sources and targets on it have to show."""
    views: dict[TriangleMesh, View] = {}
    for panel in panels(sheet):
        if panel.mesh in views:
            continue
        if views and sheet.one_view:
            views[panel.mesh] = next(iter(views.values()))
            continue
        seen = sheet.seen if not views and sheet.seen else _remarkable(sheet, panel.mesh)
        views[panel.mesh] = best_view(panel.mesh, *seen, up=sheet.up)
    return {mesh: _camera(mesh, view) for mesh, view in views.items()}


def _remarkable(sheet: Sheet, mesh: TriangleMesh) -> list[FloatArray]:
    found = []
    for panel in panels(sheet):
        paint = panel.paint
        if panel.mesh is mesh and panel.frame in ("source", "target") and isinstance(paint, Values | Streaks):
            found += [paint.values] if paint.values is not None else []
    return [values for values in found if len(values) == len(mesh.vertices)]


def _camera(mesh: TriangleMesh, view: View) -> Camera:
    places = drawing_units(mesh).drawn(mesh.vertices)
    aspect = fitted(places, view).aspect
    return fitted(places, view, min(max(aspect, NARROWEST), WIDEST))


def panel_pictures(
    sheet: Sheet,
    sizes: Sequence[tuple[int, int]],
    ranges: Mapping[str, ColorRange],
    views: Mapping[TriangleMesh, Camera],
) -> list[Image.Image]:
    """Draw all panels of a sheet, in sizes (width, height) in pixels, on a transparent ground.

    Raises
    ------
    DrawingError
        Where the machine cannot draw.
    """
    pictures: list[Image.Image | None] = [None] * len(sizes)
    everything = panels(sheet)
    for size in dict.fromkeys(sizes):  # the canvas is made once for each size
        with canvas(*size):
            for number in (i for i, other in enumerate(sizes) if other == size):
                panel = everything[number]
                _show(panel, ranges)
                views[panel.mesh].place()
                pictures[number] = Image.fromarray(drawn(transparent=True))
    return [picture for picture in pictures if picture is not None]


def _show(panel: Panel, ranges: Mapping[str, ColorRange]) -> None:
    mesh = panel.mesh
    units = drawing_units(mesh)
    places = units.drawn(mesh.vertices)
    ps.remove_all_structures()
    ps.set_ground_plane_mode("none")
    viewport.set_extent(places)
    surface = register("surface", mesh, places)
    paint = panel.paint
    if isinstance(paint, Values):
        on_vertices = len(paint.values) == len(mesh.vertices)
        show_values(surface, "values", mesh, paint.values, ranges[paint.bar], on_vertices)
    elif isinstance(paint, Coordinates):
        show_colors(surface, "coordinates", mesh, place_colors(mesh.vertices, paint.positions))
    elif isinstance(paint, Checker):
        show_checker(surface, "checker", mesh, paint.coordinates, _HALF, "unit")
    else:
        atlas, image = line_integral_convolution(mesh, paint.velocity, size=_TEXELS)
        colors = streak_texture(atlas, image, paint.values, None if paint.values is None else ranges[paint.bar])
        show_texture(surface, "streaks", colors, atlas.corner_coordinates)
    if panel.arrows is not None:
        marks.draw_arrows("arrows", mesh, panel.arrows, _ARROW_LENGTH, _ARROW_DENSITY, units.drawn, _INK)
    if panel.lines:
        marks.draw_curves("lines", panel.lines, units.drawn, _INK, _LINE)
    for number, point in enumerate([] if panel.points is None else panel.points):
        color = POINT_COLORS[number % len(POINT_COLORS)]
        marks.draw_points(f"point {number}", point[None], units.drawn, color, _POINT)

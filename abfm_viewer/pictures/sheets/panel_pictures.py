"""Pictures of a sheet's panels, drawn off the screen."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle

from PIL import Image

from abfm.io.sheets import Checker, Coordinates, Panel, Sheet, Values
from abfm.mesh import TriangleMesh
from abfm.streaks.line_integral import line_integral_convolution
from abfm_viewer.appearance.colormaps import ColorRange, place_colors
from abfm_viewer.computing.defaults import best_front
from abfm_viewer.document.document import Front
from abfm_viewer.pictures.canvas import canvas, drawn
from abfm_viewer.pictures.sheets.ranges import function, panels
from abfm_viewer.scene import opengl, overlays
from abfm_viewer.scene.camera import Camera, fitted, look
from abfm_viewer.scene.ribbons import course_through, line_ribbons
from abfm_viewer.scene.surfaces import register, show
from abfm_viewer.shown.paint import Paint, PaintKind
from abfm_viewer.shown.streak_texture import streak_texture

_FIELD_OF_VIEW, _MARGIN = 18.0, 0.04  # degrees: so narrow that shapes are hardly distorted
_INK = (0.1, 0.1, 0.12)
# of marked points, in linear light
POINT_COLORS = (
    (1.0, 0.45, 0.0),
    (0.45, 0.1, 0.75),
    (0.0, 0.5, 0.25),
    (0.85, 0.0, 0.45),
    (0.0, 0.4, 0.8),
)
_ARROWS = 0.12, 0.3  # length and density
_POINT, _LINE = 0.022, 0.005  # radii, of sqrt(area)
_TEXELS = 2048
_SQUARE = 0.5  # of a checkerboard, in its coordinates


def cameras(
    sheet: Sheet, aspects: tuple[float, float] = (0.0, math.inf)
) -> dict[TriangleMesh, Camera]:
    """One camera for each mesh, that shows what the sources and targets on it have to show.

    Its aspect is that of what it sees, or the least or greatest one of `aspects`.
    """
    fronts: dict[TriangleMesh, Front] = {}
    for panel in panels(sheet):
        if fronts and sheet.one_view:
            fronts.setdefault(panel.mesh, next(iter(fronts.values())))
        elif panel.mesh not in fronts:
            ends = [
                one
                for one in panels(sheet)
                if one.mesh is panel.mesh and one.frame in ("source", "target")
            ]
            functions = [values for _, values in map(function, ends) if values is not None]
            remarkable = [values for values in functions if len(values) == len(panel.mesh.vertices)]
            seen = sheet.seen if not fronts and sheet.seen else remarkable
            fronts[panel.mesh] = best_front(panel.mesh, *seen, up=sheet.up)
    found = {}
    for mesh, front in fronts.items():
        free = fitted(mesh.vertices, front, None, _FIELD_OF_VIEW, _MARGIN)
        aspect = min(max(free.aspect, aspects[0]), aspects[1])
        found[mesh] = fitted(mesh.vertices, front, aspect, _FIELD_OF_VIEW, _MARGIN)
    return found


def panel_pictures(
    sheet: Sheet,
    sizes: Sequence[tuple[int, int]],
    ranges: Mapping[str, ColorRange],
    views: Mapping[TriangleMesh, Camera],
) -> list[Image.Image]:
    """Draw all panels of a sheet, in sizes (width, height) in pixels, on a transparent ground.

    A `DrawingError` says why the machine cannot.
    """
    pictures: dict[int, Image.Image] = {}
    for size in dict.fromkeys(sizes):  # the canvas is made once for each size
        with canvas(*size):
            for number, panel in enumerate(panels(sheet)):
                if sizes[number] != size:
                    continue
                _show(panel, ranges, views[panel.mesh])
                pictures[number] = Image.fromarray(drawn(transparent=True))
    return [pictures[number] for number in range(len(sizes))]


def _show(panel: Panel, ranges: Mapping[str, ColorRange], view: Camera) -> None:
    mesh = panel.mesh
    opengl.clear()
    look(view, mesh)
    surface = register("surface", mesh)
    show(surface, mesh, _paint(panel, ranges), square=_SQUARE)
    if panel.arrows is not None:
        overlays.draw_arrows("arrows", mesh, panel.arrows, _ARROWS, _INK)
    if panel.lines:
        courses = [course_through(mesh, line) for line in panel.lines]
        overlays.draw_ribbons("lines", mesh, line_ribbons(courses, _LINE), _INK)
    marked = zip(() if panel.points is None else panel.points, cycle(POINT_COLORS))
    for number, (point, color) in enumerate(marked):
        overlays.draw_points(f"point {number}", mesh, point[None], color, _POINT)


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
    colors = streak_texture(atlas, image, paint.values, ranges.get(paint.bar))
    return Paint("texture", colors, label, corners=atlas.corner_coordinates)

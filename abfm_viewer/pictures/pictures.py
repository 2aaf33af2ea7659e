"""Still pictures of a match, drawn off the screen: from source to target on one colour range and one camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from abfm import Match
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance.colormaps import ColorRange, color_range
from abfm_viewer.pictures import sheet
from abfm_viewer.pictures.canvas import canvas, drawn
from abfm_viewer.scene import viewport
from abfm_viewer.scene.camera import Camera, best_view, fitted
from abfm_viewer.scene.drawing_units import drawing_units
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.surface_quantities import register, show_values

_BLUE, _BLACK, _RED, _GREY = "#2455c3", "#111111", "#c62828", "#c9c9c9"


def match_picture(
    match: Match,
    times: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    channel: int = 0,
    up: str = "y",
) -> Image.Image:
    """Source (blue frame), the source on its way, at tau (black frame), and target (red frame).

    Parameters
    ----------
    times
        When to show the source besides 0 and tau; by default at a quarter, half and three quarters of tau.
    size
        Width and height in pixels; by default a wide sheet that fits the shape.
    channel
        Which of several pairs of functions to show.
    up
        The axis that points upwards: x, y or z.

    Raises
    ------
    DrawingError
        Where the machine cannot draw.
    """
    tau = match.parameters.tau
    moments = sorted({*(tau * np.array([0.25, 0.5, 0.75]) if times is None else times), tau})
    source, target = _channel(match.source, channel), _channel(match.target, channel)
    advected = [_channel(values, channel) for values in match.advect(moments)]
    colors = color_range(source, target)

    camera = fitted(_places(match.mesh), best_view(match.mesh, source, target, up=up))
    layout = sheet.grid(len(moments) + 2, camera.aspect, size)
    pictures = surface_pictures(match.mesh, [source, *advected, target], colors, camera, layout)
    tiles = [sheet.Tile(pictures[0], "source", _BLUE, bold=True)]
    for time, picture in zip(moments, pictures[1:-1], strict=True):
        last = time == tau
        label = f"t = {time:.4g}" + (f", {match.verdict.kind}" if last else "")
        tiles.append(sheet.Tile(picture, label, _BLACK if last else _GREY, bold=last))
    tiles.append(sheet.Tile(pictures[-1], "target", _RED, bold=True))
    return sheet.compose(layout, tiles, colors)


def _channel(function: FloatArray, channel: int) -> FloatArray:
    return function.reshape(len(function), -1)[:, channel]


def _places(mesh: TriangleMesh) -> FloatArray:
    return drawing_units(mesh).drawn(mesh.vertices)


def surface_pictures(
    mesh: TriangleMesh, functions: Sequence[FloatArray], colors: ColorRange, camera: Camera, layout: sheet.Grid
) -> list[Image.Image]:
    """Draw functions (V,) on a mesh, each on a transparent ground and in the layout's tile size.

    The camera is in the units that `drawing_units` gives for the mesh.
    """
    with canvas(layout.tile_width, layout.tile_height):
        ps.remove_all_structures()
        ps.set_ground_plane_mode("none")
        places = _places(mesh)
        viewport.set_extent(places)
        surface = register("surface", mesh, places)
        camera.place()
        pictures = []
        for function in functions:
            show_values(surface, "function", mesh, function, colors, on_vertices=True)
            pictures.append(Image.fromarray(drawn(transparent=True)))
    return pictures

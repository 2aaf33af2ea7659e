"""Surfaces in polyscope, and what they can show, in windows, pictures and figures."""

import math
from typing import Any

from numpy.typing import NDArray

from abfm.mesh import TriangleMesh
from abfm_viewer.appearance import material
from abfm_viewer.appearance.colormaps import CHECKER_COLORS, DARK_CHECKER_COLORS, loaded_name
from abfm_viewer.appearance.theme import linear, palette
from abfm_viewer.document.document import Theme
from abfm_viewer.scene.creases import drawn_mesh
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.viewport import viewport
from abfm_viewer.shown.paint import Paint

_PLAIN: dict[Theme, tuple[float, float, float]] = {
    "light": (0.8, 0.81, 0.83),
    "dark": (0.3, 0.3, 0.32),
}
_CORNERS = "texture corners"
_EDGE = 1.0  # polyscope's unit: about a pixel
_LONG_EDGE, _THINNEST = 12.0, 0.3  # pixels of an edge that is drawn in full width; share of it


def show_paint(name: str, mesh: TriangleMesh, paint: Paint, before: Paint | None) -> None:
    """Show a paint on a surface, with as little work as what it showed allows."""
    surface, kind = ps.get_surface_mesh(name), paint.kind
    if before is not None and before.kind == kind:
        same_colors, same_ground = before.colors == paint.colors, before.is_dark == paint.is_dark
        if same_colors and same_ground and before.values is paint.values:
            return
        if same_colors and kind in ("vertex values", "face values"):
            surface.get_quantity_buffer(kind, "values").update_data(drawn_values(mesh, paint))
            return
        if kind == "texture" and before.corners is paint.corners:
            # cheaper than anew
            surface.get_quantity_buffer(kind, "colors").update_data(paint.values.reshape(-1, 3))
            return
    show(surface, mesh, paint)


def register(name: str, mesh: TriangleMesh) -> Any:
    """Give polyscope a surface; its creases are sharp."""
    split = drawn_mesh(mesh)
    return ps.register_surface_mesh(
        name,
        split.values(viewport(mesh).drawn(mesh.vertices)),
        split.faces,
        smooth_shade=True,
        material=material.NAME,
        color=_PLAIN["light"],
        back_face_policy=back_faces(mesh),
    )


def back_faces(mesh: TriangleMesh) -> str:
    """Return how faces are drawn from behind: not where only a closed inside is there."""
    only_inside = mesh.is_closed and not mesh.is_inside_out
    return "cull" if only_inside else "identical"


def edge_width(faces: int, scale: float) -> float:
    """Of a wireframe of so many faces of a surface of area 1, whose lengths of 1 have so many
    pixels.

    It is thin where edges are short, or they would hide the colours.
    """
    length = scale * math.sqrt(4 / (math.sqrt(3) * faces))  # in pixels, of equal triangles
    return _EDGE * min(max(round(length / _LONG_EDGE, 1), _THINNEST), 1.0)


def set_style(surface: Any, edges: float, flat: bool, theme: Theme) -> None:
    """Show edges in a width, 0 for none, and faces each in one shade or smoothly."""
    surface.set_color(_PLAIN[theme])
    surface.set_edge_color(linear(palette(theme).ink)[:3])
    surface.set_edge_width(edges)
    surface.set_smooth_shade(not flat)


def drawn_values(mesh: TriangleMesh, paint: Paint) -> NDArray[Any]:
    """A paint's values as polyscope's mesh needs them."""
    if paint.kind in ("face values", "texture"):
        return paint.values
    return drawn_mesh(mesh).values(paint.values)


def show(surface: Any, mesh: TriangleMesh, paint: Paint, square: float = 1.0) -> None:
    """Show a paint as a quantity of its kind's name; `square` is a checkerboard's unit."""
    values = drawn_values(mesh, paint)
    if paint.kind == "colors":
        surface.add_color_quantity(paint.kind, values, enabled=True)
    elif paint.kind == "checker":
        colors = DARK_CHECKER_COLORS if paint.is_dark else CHECKER_COLORS
        look = {"viz_style": "checker", "checker_size": square, "checker_colors": colors}
        surface.add_parameterization_quantity(
            paint.kind, values, coords_type="unit", enabled=True, **look
        )
    elif paint.kind == "texture":
        surface.add_parameterization_quantity(_CORNERS, paint.corners, defined_on="corners")
        place = {"defined_on": "texture", "param_name": _CORNERS, "image_origin": "lower_left"}
        surface.add_color_quantity(paint.kind, values, filter_mode="linear", enabled=True, **place)
    elif paint.colors is not None:
        surface.add_scalar_quantity(
            paint.kind,
            values,
            defined_on="faces" if paint.kind == "face values" else "vertices",
            enabled=True,
            cmap=loaded_name(paint.colors.colormap),
            vminmax=(paint.colors.low, paint.colors.high),
        )

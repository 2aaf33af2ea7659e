"""Surfaces in polyscope, and what they can show: the one place for windows, pictures and figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import NDArray

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import material
from abfm_viewer.appearance.colormaps import CHECKER_COLORS, ColorRange, loaded_name
from abfm_viewer.scene.creases import drawn_mesh
from abfm_viewer.scene.opengl import ps
from abfm_viewer.shown.paint import Paint

_PLAIN = (0.8, 0.81, 0.83)
_CORNERS = "texture corners"
_CHECKER: tuple[float, Literal["world", "unit"]] = (0.03, "world")
_EDGE = 1.0  # polyscope's unit: about a pixel
_STRIPES = 0.8  # of the light that every other stripe between isolines keeps


@dataclass(frozen=True)
class Isolines:
    """Whether a function has stripes, and how many in its range."""

    shown: bool
    count: int

    def options(self, colors: ColorRange) -> dict[str, Any]:
        """Those of polyscope."""
        if not self.shown:
            return {"isolines_enabled": False}  # polyscope would remember the last ones
        return {  # each of these alone switches them on
            "isolines_enabled": True,
            "isoline_style": "stripe",  # contours are black where a function hardly changes
            "isoline_period": (colors.high - colors.low) / max(self.count, 1),
            "isoline_darkness": _STRIPES,
        }


def show_paint(
    name: str, mesh: TriangleMesh, paint: Paint, isolines: Isolines, before: tuple[Paint, Isolines] | None
) -> None:
    """Show a paint on the surface of this name, with as little work as what it showed before allows."""
    surface, kind, colors = ps.get_surface_mesh(name), paint.kind, paint.colors
    old, old_isolines = before or (None, None)
    if old is not None and old_isolines == isolines and old.kind == kind:
        if old.colors == colors and old.values is paint.values:
            return
        if old.colors == colors and kind in ("vertex values", "face values"):
            surface.get_quantity_buffer(kind, "values").update_data(drawn_values(mesh, paint))
            return
        if kind == "texture" and old.corners is paint.corners:
            surface.get_quantity_buffer(kind, "colors").update_data(paint.values.reshape(-1, 3))  # cheaper than anew
            return
    stripes = isolines if kind == "vertex values" else Isolines(False, 0)
    show(surface, mesh, paint, stripes.options(colors) if colors else None)


def register(name: str, mesh: TriangleMesh, places: FloatArray) -> Any:
    """A surface with its vertices at places (V, 3) in drawing units; its creases are sharp."""
    split = drawn_mesh(mesh)
    return ps.register_surface_mesh(
        name,
        split.values(places),
        split.faces,
        smooth_shade=True,
        material=material.NAME,
        color=_PLAIN,
        back_face_policy="cull" if mesh.is_closed else "identical",
    )


def set_style(surface: Any, wireframe: bool, flat: bool, ink: Sequence[float]) -> None:
    """Show a surface's edges or not, and its faces each in one shade or smoothly."""
    surface.set_edge_color(ink[:3])
    surface.set_edge_width(_EDGE if wireframe else 0.0)
    surface.set_smooth_shade(not flat)


def drawn_values(mesh: TriangleMesh, paint: Paint) -> NDArray[Any]:
    """A paint's values as polyscope's mesh needs them."""
    return paint.values if paint.kind in ("face values", "texture") else drawn_mesh(mesh).values(paint.values)


def show(
    surface: Any,
    mesh: TriangleMesh,
    paint: Paint,
    isolines: dict[str, Any] | None = None,
    checker: tuple[float, Literal["world", "unit"]] = _CHECKER,
) -> None:
    """Show a paint on a surface of a mesh, as a quantity of its kind's name.

    `isolines` are polyscope's options, and `checker` the size of a checkerboard's fields in one of its units.
    """
    values = drawn_values(mesh, paint)
    if paint.kind == "colors":
        surface.add_color_quantity(paint.kind, values, enabled=True)
    elif paint.kind == "checker":
        size, units = checker
        look = {"viz_style": "checker", "checker_size": size, "checker_colors": CHECKER_COLORS}
        surface.add_parameterization_quantity(paint.kind, values, coords_type=units, enabled=True, **look)
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
            **(isolines or {}),
        )

"""Surfaces in polyscope, and what they can show: the one place for windows, pictures and figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
_CHECKER = 0.03
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
    if before is not None and before[1] == isolines and before[0].kind == kind:
        old = before[0]
        if old.colors == colors and old.values is paint.values:
            return
        if old.colors == colors and kind in ("vertex values", "face values"):
            values = drawn_mesh(mesh).values(paint.values) if kind == "vertex values" else paint.values
            surface.get_quantity_buffer(kind, "values").update_data(values)
            return
        if kind == "texture" and old.corners is paint.corners:
            surface.get_quantity_buffer(kind, "colors").update_data(paint.values.reshape(-1, 3))  # cheaper than anew
            return
    if kind in ("vertex values", "face values"):
        assert colors is not None
        on_vertices = kind == "vertex values"
        stripes = isolines if on_vertices else Isolines(False, 0)
        show_values(surface, kind, mesh, paint.values, colors, on_vertices, stripes.options(colors))
    elif kind == "colors":
        show_colors(surface, kind, mesh, paint.values)
    elif kind == "texture":
        show_texture(surface, kind, paint.values, paint.corners)
    else:
        show_checker(surface, kind, mesh, paint.values, _CHECKER)


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


def show_values(
    surface: Any,
    name: str,
    mesh: TriangleMesh,
    values: NDArray[Any],
    colors: ColorRange,
    on_vertices: bool,
    isolines: dict[str, Any] | None = None,
) -> None:
    """Show a function of the vertices (V,) or else of the faces (F,); `isolines` are polyscope's options."""
    surface.add_scalar_quantity(
        name,
        drawn_mesh(mesh).values(values) if on_vertices else values,
        defined_on="vertices" if on_vertices else "faces",
        enabled=True,
        cmap=loaded_name(colors.colormap),
        vminmax=(colors.low, colors.high),
        **(isolines or {}),
    )


def show_colors(surface: Any, name: str, mesh: TriangleMesh, colors: NDArray[Any]) -> None:
    """Show a colour (V, 3) in linear light at each vertex."""
    surface.add_color_quantity(name, drawn_mesh(mesh).values(colors), enabled=True)


def show_checker(
    surface: Any, name: str, mesh: TriangleMesh, coordinates: NDArray[Any], size: float, units: str = "world"
) -> None:
    """Show a checkerboard by texture coordinates (V, 2); `size` of its fields is in polyscope's `units`."""
    surface.add_parameterization_quantity(
        name,
        drawn_mesh(mesh).values(coordinates),
        coords_type=units,
        enabled=True,
        viz_style="checker",
        checker_size=size,
        checker_colors=CHECKER_COLORS,
    )


def show_texture(surface: Any, name: str, colors: NDArray[Any], corners: FloatArray | None) -> None:
    """Show a texture (size, size, 3) in linear light, in which the faces' corners lie at (3F, 2)."""
    surface.add_parameterization_quantity(_CORNERS, corners, defined_on="corners")
    surface.add_color_quantity(
        name,
        colors,
        defined_on="texture",
        param_name=_CORNERS,
        image_origin="lower_left",
        filter_mode="linear",
        enabled=True,
    )

"""Surfaces in polyscope, and what they can show: the one place for windows, pictures and figures."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import material
from abfm_viewer.appearance.colormaps import CHECKER_COLORS, ColorRange, loaded_name
from abfm_viewer.scene.creases import drawn_mesh
from abfm_viewer.scene.opengl import ps

_PLAIN = (0.8, 0.81, 0.83)
_CORNERS = "texture corners"


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

"""Meshes in polyscope: coordinates, creases, styles, paints (colours), and cameras of pictures."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import TriangleMesh, per_mesh
from abfm.pages.colormaps import CHECKER_COLORS, DARK_CHECKER_COLORS, colors_of, polyscope_name
from abfm.pages.creases import drawn_mesh
from abfm.pages.front import Front, Triple, triple
from abfm.types import FloatArray
from abfm_viewer.appearance.theme import linear, palette
from abfm_viewer.document.document import Theme
from abfm_viewer.scene.opengl import MATERIAL, ps
from abfm_viewer.shown.colored_values import PLAIN_COLORS
from abfm_viewer.shown.paint import Paint

_CORNERS = "texture corners"
_OF_FUNCTIONS = "vertex values", "face values"
_EDGE_WIDTH = 1.0  # in polyscope's unit, about a pixel
_FULL_WIDTH_EDGE_PIXELS = 12.0  # length of an edge that is drawn in full width
_EDGE_WIDTH_SHARE_MIN = 0.3


class Viewport:
    """Coordinates in which a mesh is drawn: relative to its middle, in units of sqrt(area).

    Original coordinates would lose precision, because graphics cards have only 7 digits.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.centre: FloatArray = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self.length = mesh.length_scale

    def drawn(self, points: FloatArray) -> FloatArray:
        return (points - self.centre) / self.length

    def undrawn(self, points: FloatArray) -> FloatArray:
        return self.centre + self.length * points


viewport = per_mesh(Viewport)
"""Function that returns the `Viewport` of a mesh, which is computed once for each mesh."""


def register(name: str, mesh: TriangleMesh) -> Any:
    split = drawn_mesh(mesh)
    return ps.register_surface_mesh(
        name,
        split.values(viewport(mesh).drawn(mesh.vertices)),
        split.faces,
        smooth_shade=True,
        material=MATERIAL,
        color=PLAIN_COLORS["light"],
        back_face_policy=back_faces(mesh),
    )


def back_faces(mesh: TriangleMesh) -> str:
    """Return polyscope's policy for the backs of faces, which are not drawn if a mesh is closed."""
    return "cull" if mesh.is_closed and not mesh.is_inside_out else "identical"


def edge_width(faces: int, scale: float) -> float:
    """Return the width of wireframe edges, less for short edges, which would hide the colours.

    ``scale`` is the number of pixels per sqrt(area).
    """
    length = scale * math.sqrt(4 / (math.sqrt(3) * faces))  # in pixels, of equal triangles
    return _EDGE_WIDTH * min(
        max(round(length / _FULL_WIDTH_EDGE_PIXELS, 1), _EDGE_WIDTH_SHARE_MIN), 1.0
    )


def set_style(name: str, edges: float, flat: bool, theme: Theme) -> None:
    """Set the width of a surface's edges (0 for none), and flat or smooth shading of its faces."""
    surface = ps.get_surface_mesh(name)
    surface.set_color(PLAIN_COLORS[theme])
    surface.set_edge_color(linear(palette(theme).ink)[:3])
    surface.set_edge_width(edges)
    surface.set_smooth_shade(not flat)


def show_paint(name: str, mesh: TriangleMesh, paint: Paint, before: Paint | None) -> None:
    """Show the colours of a paint on a surface; update only what differs from the earlier paint."""
    surface, kind = ps.get_surface_mesh(name), paint.kind
    if before is not None and before.kind == kind:
        same_colors, same_ground = before.colors == paint.colors, before.is_dark == paint.is_dark
        same_shares = before.unknown is paint.unknown and before.determined is paint.determined
        if same_colors and same_ground and same_shares and before.values is paint.values:
            return
        if same_colors and same_ground and kind in _OF_FUNCTIONS and same_shares:
            buffer = "colors" if _is_mixed(paint) else "values"
            surface.get_quantity_buffer(kind, buffer).update_data(_drawn_values(mesh, paint))
            return
        if kind == "texture" and before.corners is paint.corners:
            # cheaper than a new quantity
            surface.get_quantity_buffer(kind, "colors").update_data(paint.values.reshape(-1, 3))
            return
    show(surface, mesh, paint)


def _is_mixed(paint: Paint) -> bool:
    """Return whether a surface does not only have the colours of values."""
    return paint.unknown is not None or paint.determined is not None


def _drawn_values(mesh: TriangleMesh, paint: Paint) -> NDArray[Any]:
    values = paint.values
    if paint.kind in _OF_FUNCTIONS and _is_mixed(paint) and paint.colors is not None:
        values = colors_of(values, paint.colors, paint.unknown)
        if paint.determined is not None:
            plain = np.array(PLAIN_COLORS["dark" if paint.is_dark else "light"])
            values = plain + paint.determined[:, None] * (values - plain)
    of_vertices = paint.kind not in ("face values", "texture")
    return drawn_mesh(mesh).values(values) if of_vertices else values


def show(surface: Any, mesh: TriangleMesh, paint: Paint, square: float = 1.0) -> None:
    """Show a paint as a quantity of polyscope; ``square`` is the side of checkerboard squares."""
    kind, values = paint.kind, _drawn_values(mesh, paint)
    options: dict[str, Any] = {"enabled": True}
    if kind == "colors":
        surface.add_color_quantity(kind, values, **options)
    elif kind == "checker":
        colors = DARK_CHECKER_COLORS if paint.is_dark else CHECKER_COLORS
        options |= {"viz_style": "checker", "checker_size": square, "checker_colors": colors}
        surface.add_parameterization_quantity(kind, values, coords_type="unit", **options)
    elif kind == "texture":
        surface.add_parameterization_quantity(_CORNERS, paint.corners, defined_on="corners")
        options |= {"defined_on": "texture", "param_name": _CORNERS, "image_origin": "lower_left"}
        surface.add_color_quantity(kind, values, filter_mode="linear", **options)
    elif paint.colors is not None:
        options |= {"defined_on": "faces" if kind == "face values" else "vertices"}
        if _is_mixed(paint):
            surface.add_color_quantity(kind, values, **options)
            return
        options |= {"cmap": polyscope_name(paint.colors.colormap)}
        ends = paint.colors.low, paint.colors.high
        surface.add_scalar_quantity(kind, values, vminmax=ends, **options)


@dataclass(frozen=True)
class Camera:
    position: Triple
    target: Triple
    front: Front
    angle: float  # vertical, in degrees
    aspect: float  # width over height

    @property
    def height(self) -> float:
        """Height of the region that the camera sees at the distance of its target."""
        distance = math.dist(self.position, self.target)
        return 2 * distance * math.tan(math.radians(self.angle / 2))


def fitted(
    vertices: FloatArray,
    front: Front,
    aspect: float | None = None,
    angle: float = 18.0,
    margin: float = 0.04,
) -> Camera:
    """Return the nearest camera that sees all vertices (V, 3) from a front.

    ``aspect`` is width over height, by default that of the vertices. ``angle``, in degrees, is so
    small that the perspective hardly distorts shapes. ``margin`` is relative to the size of the
    surface.
    """
    x, y, z = front.axes @ vertices.T
    middle = np.array([(values.min() + values.max()) / 2 for values in (x, y, z)])
    half_width, half_height = np.abs(x - middle[0]), np.abs(y - middle[1])
    if aspect is None:
        aspect = float(half_width.max() / half_height.max())
    extent = np.maximum(half_width / aspect, half_height) * (1 + 2 * margin)
    distance = float((z - middle[2] + extent / np.tan(np.radians(angle / 2))).max())
    target = middle @ front.axes
    position = target + distance * np.array(front.direction)
    return Camera(triple(position), triple(target), front, angle, aspect)


def set_camera(camera: Camera, mesh: TriangleMesh) -> None:
    places = viewport(mesh).drawn(mesh.vertices)
    low, high = places.min(axis=0), places.max(axis=0)
    ps.set_bounding_box(low, high)
    ps.set_length_scale(2 * float(np.linalg.norm(high - low)))
    position, target = viewport(mesh).drawn(np.array([camera.position, camera.target]))
    ps.set_vertical_fov_degrees(camera.angle)
    ps.look_at_dir(position, target, np.array(camera.front.up))

"""A camera for a part of the window: what the panels leave free, or a whole picture.

Cameras and points are in the mesh's units; polyscope draws in others, which are set here.
"""

from __future__ import annotations

import numpy as np

from abfm.types import FloatArray
from abfm_viewer.document.document import Camera, triple
from abfm_viewer.scene.camera import View
from abfm_viewer.scene.drawing_units import DrawingUnits
from abfm_viewer.scene.opengl import ps
from abfm_viewer.widgets.widget_record import Rect

_FIELD_OF_VIEW = 9.0  # degrees, vertical: so narrow that the surfaces in a row look alike

units = DrawingUnits(np.zeros(3), 1.0)
"""What polyscope's structures and camera are in; set with `set_units`."""


def set_units(of_what_is_drawn: DrawingUnits) -> None:
    """Let cameras and points be converted from and to other units."""
    global units
    units = of_what_is_drawn


def set_extent(points: FloatArray) -> None:
    """Let the camera see no farther than points (P, 3), in the units that are drawn."""
    low, high = points.min(axis=0), points.max(axis=0)
    ps.set_automatically_compute_scene_extents(False)
    ps.set_bounding_box(low, high)
    ps.set_length_scale(2 * float(np.linalg.norm(high - low)))  # also gives the step of the mouse wheel


def fitted(vertices: FloatArray, view: View, rect: Rect, margin: float = 0.05) -> Camera:
    """The nearest camera in a direction that sees all vertices (V, 3) in a rectangle of the window."""
    aspect = (rect[2] - rect[0]) / (rect[3] - rect[1])
    axes = np.stack([np.cross(view.up, view.direction), view.up, view.direction])
    x, y, z = axes @ vertices.T
    middle = np.array([(values.min() + values.max()) / 2 for values in (x, y, z)])
    extent = np.maximum(np.abs(x - middle[0]) / aspect, np.abs(y - middle[1])) * (1 + 2 * margin)
    distance = float((z - middle[2] + extent / np.tan(np.radians(_FIELD_OF_VIEW / 2))).max())
    target = middle @ axes
    position = target + distance * view.direction
    return Camera(triple(position), triple(target), triple(view.up), _FIELD_OF_VIEW)


def view_of(camera: Camera) -> View:
    """The direction in which a camera looks, without its distance."""
    backward = np.array(camera.position) - camera.target
    return View(backward / np.linalg.norm(backward), np.array(camera.up))


def place(camera: Camera, rect: Rect, size: tuple[int, int], whole: bool = False) -> None:
    """Make polyscope draw what a camera sees into a rectangle of a window of a given size.

    Parameters
    ----------
    whole
        See the camera's whole width, too, where the rectangle is narrower than its aspect.
    """
    width, height = rect[2] - rect[0], rect[3] - rect[1]
    half = np.tan(np.radians(camera.angle / 2)) * max(1.0, camera.aspect * height / width if whole else 0.0)
    position, target = units.drawn(np.array([camera.position, camera.target]))
    up = np.array(camera.up)
    backward = position - target
    distance = np.linalg.norm(backward)
    right = np.cross(up, backward) / distance
    per_pixel = 2 * half * distance / height
    offset = _offset(rect, size) * per_pixel
    shift = -offset[0] * right + offset[1] * up
    ps.set_vertical_fov_degrees(float(np.degrees(2 * np.arctan(half * size[1] / height))))
    ps.look_at_dir(position + shift, target + shift, up)
    ps.set_view_center_raw(target)


def seen(rect: Rect, size: tuple[int, int]) -> Camera:
    """The camera that `place` would need to draw what polyscope draws now."""
    height = rect[3] - rect[1]
    half_window = np.tan(np.radians(ps.get_vertical_fov_degrees() / 2))
    rotation, translation = np.split(np.asarray(ps.get_camera_view_matrix())[:3], [3], axis=1)
    position = -rotation.T @ translation[:, 0]
    right, up, backward = rotation
    distance = max(float((position - np.asarray(ps.get_view_center())) @ backward), 1e-9)
    offset = _offset(rect, size) * (2 * half_window * distance / size[1])
    position = position + offset[0] * right - offset[1] * up
    angle = float(np.degrees(2 * np.arctan(half_window * height / size[1])))
    aspect = (rect[2] - rect[0]) / height
    position, target = units.undrawn(np.array([position, position - distance * backward]))
    return Camera(triple(position), triple(target), triple(up), angle, aspect)


def alike(one: Camera, other: Camera) -> bool:
    """Whether two cameras see the same, but for rounding."""
    places = units.drawn(np.array([one.position, one.target, other.position, other.target]))
    return bool(np.allclose(places[:2], places[2:], rtol=1e-4, atol=1e-6) and np.isclose(one.angle, other.angle, 1e-4))


def projected(points: FloatArray) -> FloatArray:
    """Window coordinates (P, 2) and depth of points (P, 3): (P, 3); the depth is negative behind the camera."""
    width, height = ps.get_window_size()
    half = np.tan(np.radians(ps.get_vertical_fov_degrees() / 2))
    view = np.asarray(ps.get_camera_view_matrix())
    x, y, z = view[:3, :3] @ units.drawn(np.atleast_2d(points)).T + view[:3, 3:]
    depth = -z
    scale = height / 2 / half / np.where(np.abs(depth) > 1e-12, depth, 1e-12)
    return np.stack([width / 2 + scale * x, height / 2 - scale * y, depth], axis=1)


def _offset(rect: Rect, size: tuple[int, int]) -> FloatArray:
    """From the window's middle to the rectangle's, in pixels, y downwards."""
    return np.array([(rect[0] + rect[2] - size[0]) / 2, (rect[1] + rect[3] - size[1]) / 2])

"""Polyscope's camera for a mesh, in a part of the window: what the panels leave free, or a whole picture."""

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Camera, triple
from abfm_viewer.scene.opengl import ps
from abfm_viewer.widgets.widget_record import Rect


class Viewport:
    """Cameras and points are in a mesh's units; polyscope draws in others, as graphics cards have but seven digits.

    Its coordinates count from the middle of the mesh's bounding box, with the square root of the area as the unit.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.center: FloatArray = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self.length = mesh.length_scale

    def drawn(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) as polyscope draws them."""
        return (points - self.center) / self.length

    def undrawn(self, points: FloatArray) -> FloatArray:
        """The inverse of `drawn`."""
        return self.center + self.length * points

    def set_extent(self, points: FloatArray) -> None:
        """Let the camera see no farther than points (P, 3)."""
        places = self.drawn(points)
        low, high = places.min(axis=0), places.max(axis=0)
        ps.set_automatically_compute_scene_extents(False)
        ps.set_bounding_box(low, high)
        ps.set_length_scale(2 * float(np.linalg.norm(high - low)))  # also gives the step of the mouse wheel

    def place(self, camera: Camera, rect: Rect, whole: bool = False) -> None:
        """Make polyscope draw what a camera sees into a rectangle of the window.

        `whole` is to see the camera's whole width, too, where the rectangle is narrower than its aspect.
        """
        width, height = rect[2] - rect[0], rect[3] - rect[1]
        half = np.tan(np.radians(camera.angle / 2)) * max(1.0, camera.aspect * height / width if whole else 0.0)
        position, target = self.drawn(np.array([camera.position, camera.target]))
        up = np.array(camera.up)
        backward = position - target
        distance = np.linalg.norm(backward)
        right = np.cross(up, backward) / distance
        offset = _offset(rect) * 2 * half * distance / height
        shift = -offset[0] * right + offset[1] * up
        ps.set_vertical_fov_degrees(float(np.degrees(2 * np.arctan(half * ps.get_window_size()[1] / height))))
        ps.look_at_dir(position + shift, target + shift, up)
        ps.set_view_center_raw(target)

    def seen(self, rect: Rect) -> Camera:
        """The camera that `place` would need to draw what polyscope draws now."""
        height, window_height = rect[3] - rect[1], ps.get_window_size()[1]
        half_window = np.tan(np.radians(ps.get_vertical_fov_degrees() / 2))
        rotation, translation = np.split(np.asarray(ps.get_camera_view_matrix())[:3], [3], axis=1)
        position = -rotation.T @ translation[:, 0]
        right, up, backward = rotation
        distance = max(float((position - np.asarray(ps.get_view_center())) @ backward), 1e-9)
        offset = _offset(rect) * (2 * half_window * distance / window_height)
        position = position + offset[0] * right - offset[1] * up
        angle = float(np.degrees(2 * np.arctan(half_window * height / window_height)))
        position, target = self.undrawn(np.array([position, position - distance * backward]))
        return Camera(triple(position), triple(target), triple(up), angle, (rect[2] - rect[0]) / height)

    def alike(self, one: Camera, other: Camera) -> bool:
        """Whether two cameras see the same, but for rounding."""
        places = self.drawn(np.array([one.position, one.target, other.position, other.target]))
        near = np.allclose(places[:2], places[2:], rtol=1e-4, atol=1e-6)
        return bool(near and np.isclose(one.angle, other.angle, 1e-4))

    def projected(self, points: FloatArray) -> FloatArray:
        """Window coordinates (P, 2) and depth of points (P, 3): (P, 3); the depth is negative behind the camera."""
        width, height = ps.get_window_size()
        half = np.tan(np.radians(ps.get_vertical_fov_degrees() / 2))
        view = np.asarray(ps.get_camera_view_matrix())
        x, y, z = view[:3, :3] @ self.drawn(np.atleast_2d(points)).T + view[:3, 3:]
        depth = -z
        scale = height / 2 / half / np.where(np.abs(depth) > 1e-12, depth, 1e-12)
        return np.stack([width / 2 + scale * x, height / 2 - scale * y, depth], axis=1)


def _offset(rect: Rect) -> FloatArray:
    """From the window's middle to the rectangle's, in pixels, y downwards."""
    width, height = ps.get_window_size()
    return np.array([(rect[0] + rect[2] - width) / 2, (rect[1] + rect[3] - height) / 2])

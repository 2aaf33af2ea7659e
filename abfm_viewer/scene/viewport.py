"""Polyscope's camera for a mesh: for slots of a window, or for one surface in a whole picture."""

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Camera
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.slot_view import SlotView

_AWAY = 4.0  # the viewer, in radii of a surface, of which a part may be two radii before its slot's middle


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
        ps.set_bounding_box(low, high)
        ps.set_length_scale(2 * float(np.linalg.norm(high - low)))

    def place(self, camera: Camera) -> None:
        """Make polyscope draw what a camera sees."""
        position, target = self.drawn(np.array([camera.position, camera.target]))
        ps.set_vertical_fov_degrees(camera.angle)
        ps.look_at_dir(position, target, np.array(camera.up))

    def face(self, view: SlotView) -> None:
        """Make polyscope draw slots: in parallel projection along z, the window's middle at 0."""
        half = ps.get_window_size()[1] / (2 * view.scale)
        ps.set_view_projection_mode("orthographic")
        ps.set_length_scale(view.radius)  # it sees 20 times as far,
        ps.set_vertical_fov_degrees(float(np.degrees(2 * np.arctan(half / (2 * view.radius)))))  # and twice as high
        ps.look_at_dir((0.0, 0.0, _AWAY * view.radius), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))

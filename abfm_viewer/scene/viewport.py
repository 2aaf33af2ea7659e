"""Polyscope's coordinates, and its camera for the slots of a window."""

import numpy as np

from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.slot_view import SlotView

# the viewer, in radii of a surface, of which a part may be two radii before its slot's middle
_AWAY = 4.0


class Viewport:
    """Coordinates in which polyscope draws a mesh, as graphics cards have but seven digits.

    They count from the middle of the mesh's bounding box, with the square root of the area as the
    unit.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.center: FloatArray = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self.length = mesh.length_scale

    def drawn(self, points: FloatArray) -> FloatArray:
        """Return points (..., 3) as polyscope draws them."""
        return (points - self.center) / self.length

    def undrawn(self, points: FloatArray) -> FloatArray:
        """Return points (..., 3) in the mesh's units: the inverse of `drawn`."""
        return self.center + self.length * points


@per_mesh
def viewport(mesh: TriangleMesh) -> Viewport:
    """Return the coordinates in which a mesh is drawn."""
    return Viewport(mesh)


def face(view: SlotView) -> None:
    """Make polyscope draw slots: in parallel projection along z, the window's middle at 0."""
    half = ps.get_window_size()[1] / (2 * view.scale)
    ps.set_view_projection_mode("orthographic")
    ps.set_length_scale(view.radius)  # it sees 20 times as far,
    # and twice as high
    ps.set_vertical_fov_degrees(float(np.degrees(2 * np.arctan(half / (2 * view.radius)))))
    ps.look_at_dir((0.0, 0.0, _AWAY * view.radius), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))

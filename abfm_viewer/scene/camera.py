"""Cameras that fill a picture with one mesh, as panels of sheets do."""

from dataclasses import dataclass

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Front, Triple, triple
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.surfaces import viewport


@dataclass(frozen=True)
class Camera:
    """Where it is, what it looks at, its vertical angle in degrees, width over height."""

    position: Triple
    target: Triple
    front: Front
    angle: float
    aspect: float


def fitted(
    vertices: FloatArray, front: Front, aspect: float | None, angle: float, margin: float
) -> Camera:
    """Find the nearest camera that sees all vertices (V, 3); the margin is a share of them."""
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


def look(camera: Camera, mesh: TriangleMesh) -> None:
    """Make polyscope draw what a camera sees of a mesh, and no farther."""
    places = viewport(mesh).drawn(mesh.vertices)
    low, high = places.min(axis=0), places.max(axis=0)
    ps.set_bounding_box(low, high)
    ps.set_length_scale(2 * float(np.linalg.norm(high - low)))
    position, target = viewport(mesh).drawn(np.array([camera.position, camera.target]))
    ps.set_vertical_fov_degrees(camera.angle)
    ps.look_at_dir(position, target, np.array(camera.front.up))

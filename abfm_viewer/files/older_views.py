"""Views as versions before slots wrote them: one camera that saw all surfaces side by side."""

from typing import Any

import numpy as np

from abfm import TriangleMesh
from abfm_viewer.document.document import NEAREST, Camera, Document, Front, Look, View, triple
from abfm_viewer.files.plain import PlainError, from_plain

_SPACING, _STACKING = 1.15, 1.25  # of what a surface took in the row or column
_MARGIN = 0.05
_NEAR = 1.05  # a zoom above which the camera looked at one of them


def taken_camera(document: dict[str, Any]) -> tuple[dict[str, Any], Camera | None]:
    """The plain values of a document without the camera of its view, and that camera if there is one.

    A camera that makes no sense is a `ValueError`.
    """
    view = document.get("view")
    if not (isinstance(view, dict) and "camera" in view):
        return document, None
    where = "project.document.view.camera"
    camera: Camera | None = from_plain(Camera | None, view["camera"], where)
    if camera is not None and camera.position == camera.target:
        raise PlainError(f"the camera looks from {camera.position} at itself")
    if camera is not None and not 0 < camera.angle < 180:
        raise PlainError(f"the camera's angle is {camera.angle}; expected between 0 and 180")
    return {**document, "view": {name: value for name, value in view.items() if name != "camera"}}, camera


def look_through(camera: Camera, document: Document) -> Look:
    """What a camera showed: the same side, and where it was nearer than needed to see all, as near and the same point.

    It saw names and colour bars, too, so that what it saw of the surfaces is not known exactly.
    """
    mesh, view = document.mesh, document.view
    side = _upright(camera)
    front = view.front or side
    low, high = _extent(mesh, front)
    step, size = _side_by_side(view, front, high - low)
    fitted = (1 + 2 * _MARGIN) * max(size[1], size[0] / (camera.aspect or size[0] / size[1]))
    seen = 2 * np.linalg.norm(np.subtract(camera.position, camera.target)) * np.tan(np.radians(camera.angle / 2))
    zoom = min(float(fitted / seen), NEAREST)
    if zoom < _NEAR:
        return Look(side)
    places = [np.array(camera.target) - number * step for number in range(len(view.surfaces))]
    middle = (low + high) / 2 @ front.axes
    nearest = min(places, key=lambda place: float(np.linalg.norm(place - middle)))
    inside = np.clip(front.axes @ nearest, low, high) @ front.axes
    return Look(side, zoom, triple(inside))


def _upright(camera: Camera) -> Front:
    """The side that a camera saw, to the last digit of its axes, which graphics cards do not give."""
    backward = np.subtract(camera.position, camera.target)
    right = np.cross(camera.up, backward)
    up = np.cross(backward, right)
    return Front(triple(backward / np.linalg.norm(backward)), triple(up / np.linalg.norm(up)))


def _extent(mesh: TriangleMesh, front: Front) -> tuple[Any, Any]:
    """The ends (3,) of a mesh along a front's axes."""
    along = mesh.vertices @ front.axes.T
    return along.min(axis=0), along.max(axis=0)


def _side_by_side(view: View, front: Front, size: Any) -> tuple[Any, tuple[float, float]]:
    """How far surfaces of a size (3,) stood apart, as a vector (3,), and the width and height of all together."""
    width, height, gaps = float(size[0]), float(size[1]), len(view.surfaces) - 1
    if view.layout == "column":
        return -_STACKING * height * front.axes[1], (width, (1 + _STACKING * gaps) * height)
    return _SPACING * width * front.axes[0], ((1 + _SPACING * gaps) * width, height)

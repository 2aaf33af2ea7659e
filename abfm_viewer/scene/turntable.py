"""Surfaces that turn in a movie, each about its own upright axis, before a camera that stays."""

from dataclasses import dataclass

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray

_POINTS_OF_A_RIM = 32


@dataclass(frozen=True, eq=False)
class Turntable:
    """The cylinder in which a mesh turns."""

    middle: FloatArray  # (3,), on the axis
    axis: FloatArray  # (3,): its direction, which is one of the coordinates'
    radius: float  # the farthest vertex's distance from the axis
    low: float  # the mesh's ends along the axis, from the middle
    high: float

    def rims(self) -> FloatArray:
        """Points (2 n, 3) of the cylinder's upper and lower rim."""
        first = np.roll(self.axis, 1)
        angles = np.linspace(0, 2 * np.pi, _POINTS_OF_A_RIM, endpoint=False)[:, None]
        circle = self.radius * (
            np.cos(angles) * first + np.sin(angles) * np.cross(self.axis, first)
        )
        return np.concatenate(
            [self.middle + circle + end * self.axis for end in (self.low, self.high)]
        )

    def turned(self, degrees: float, center: FloatArray) -> FloatArray:
        """The matrix (4, 4) that turns about a parallel of the axis through a point (3,)."""
        from scipy.spatial.transform import Rotation  # not before: the first frame does without

        rotation = Rotation.from_rotvec(degrees * self.axis, degrees=True).as_matrix()
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, center - rotation @ center
        return matrix


def turntable(mesh: TriangleMesh, up: FloatArray) -> Turntable:
    """Turn a mesh about the coordinate axis that points up most, through its middle."""
    upright = int(np.argmax(np.abs(up)))
    axis = np.sign(up[upright]) * np.eye(3)[upright]
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    along = (mesh.vertices - middle) @ axis
    radius = np.linalg.norm(mesh.vertices - middle - along[:, None] * axis, axis=1).max()
    return Turntable(middle, axis, float(radius), float(along.min()), float(along.max()))

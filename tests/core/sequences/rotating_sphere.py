"""Frames of a function that rotates with a sphere about the z axis, shared by tests."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import abfm
from abfm.sequences import defaults
from tests.shapes import icosphere

MESH = icosphere(2)
TIMES = 0.05 * np.arange(5) - 0.1
SPEED = 2.0  # radians per unit of time


def rotating_frames(mesh=MESH, times=TIMES):
    """Return frames (T, V) of a function that rotates about z."""

    def frame(time):
        x, y, z = Rotation.from_euler("z", -SPEED * time).apply(mesh.vertices.copy()).T
        return x * z + y + 0.5 * x * x

    return np.stack([frame(time) for time in times])


@cache
def solved():
    return abfm.sequence(MESH, rotating_frames(), TIMES, defaults(sigma=0.1))

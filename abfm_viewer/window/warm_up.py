"""Loads and compiles what a match and its pictures need while the user looks at the first picture."""

import threading
from contextlib import suppress

import numpy as np

import abfm
from abfm_viewer import shown


def start() -> threading.Thread:
    """Begin in the background; compiled kernels are cached, so that only the first launch compiles."""
    thread = threading.Thread(target=_match_something, name="warm up", daemon=True)
    thread.start()
    return thread


def _match_something() -> None:
    """A match on an octahedron; what fails here fails again, and is told, when the user presses Match."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    mesh = abfm.TriangleMesh(corners, np.array(faces))
    with suppress(Exception):
        result = abfm.match(mesh, corners[:, 0], corners[:, 1], abfm.Parameters(iterations=2))
        result.advect([0.0, 0.5])
        atlas, image = abfm.streaks.line_integral_convolution(mesh, result.velocity[0], size=16)
        shown.streak_texture(atlas, (255 * image).astype(np.uint8))

"""Loads and compiles what a match needs while the user looks at the first picture."""

import threading
from contextlib import suppress

import numpy as np

import abfm
from abfm.mesh.subdivision import subdivided
from abfm_viewer import shown
from abfm_viewer.shown.arrows import ArrowStyle, arrows_of
from abfm_viewer.shown.eye import Eye


def start() -> threading.Thread:
    """Begin in the background; kernels are cached, so only the first launch compiles."""
    thread = threading.Thread(target=_match_something, name="warm up", daemon=True)
    thread.start()
    return thread


def _match_something() -> None:
    """Match by way of a coarser mesh; a failure is told where it is asked for."""
    corners = np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64
    )
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    with suppress(Exception):
        mesh = subdivided(subdivided(abfm.TriangleMesh(corners, np.array(faces))))
        source, target, _ = mesh.vertices.T
        result = abfm.match(mesh, source, target, abfm.Parameters.of(iterations=8, levels=2))
        result.advect([0.0, 0.5])
        atlas, image = abfm.streaks.line_integral_convolution(mesh, result.velocity[0], size=64)
        shown.streak_texture(atlas, (255 * image).astype(np.uint8))
        look, eye = ArrowStyle(length=0.1, spacing=0.1), Eye(np.eye(3))
        arrows_of(mesh, result.velocity[0], look, eye).hidden(eye)

"""Import and compilation of the code of a match, in the background after the first frame."""

import threading
from contextlib import suppress

import numpy as np

import abfm
from abfm.mesh.subdivision import subdivided
from abfm_viewer import shown
from abfm_viewer.shown.arrows import ArrowStyle, arrows_of
from abfm_viewer.shown.eye import Eye


def start() -> threading.Thread:
    """Start the warm-up in a thread. Only the first launch compiles, as kernels are cached."""
    thread = threading.Thread(target=_match_something, name="warm up", daemon=True)
    thread.start()
    return thread


def _match_something() -> None:
    """Solve a small match; ignore errors, which a real match would report."""
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
        arrow_style, eye = ArrowStyle(length=0.1, spacing=0.1), Eye(np.eye(3))
        arrows_of(mesh, result.velocity[0], arrow_style, eye).hidden(eye)

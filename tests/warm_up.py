"""Compile kernels once before all tests, so that test processes load them from the cache.

Run with ``python -m tests.warm_up``.
"""

import tempfile
from pathlib import Path

import numpy as np

import abfm
from abfm.flow import flow_lines
from abfm.maps import vertex_points
from abfm.maps.continuous_map import continuous_map
from abfm.maps.spherical import SphereLayout
from abfm.mesh.shapes import even_sphere, five_limbs
from abfm.registration.initial.sphere_rotations import SphereFunctions, rotation_by_functions
from abfm_viewer.window import warm_up

_FEW_ITERATIONS = abfm.Parameters.of(iterations=2, refine=0)
_CONCAVE = "OFF\n6 6 0\n0 0 0\n2 0 0\n2 2 0\n1 1 0\n0 2 0\n1 1 2\n5 4 3 2 1 0\n" + "".join(
    f"3 {a} {(a + 1) % 5} 5\n" for a in range(5)
)


def compile_kernels():
    """Run a short example of each computation that uses compiled kernels."""
    warm_up.start().join()
    body = five_limbs(300)
    match = abfm.match(body, *body.vertices.T[:2], _FEW_ITERATIONS)
    flow_lines(body, match.velocity[0], vertex_points(body), 0.1)
    abfm.match(body, *body.vertices.T[:2], _FEW_ITERATIONS.with_values(method="linearised"))
    abfm.streaks.line_integral_convolution(body, match.velocity[0], size=96, fade=True)
    other = abfm.TriangleMesh(2 * body.vertices, body.faces)
    pairs = [[3, 4], [77, 78], [150, 151], [290, 291]]
    abfm.register(body, other, initial="embedding", landmarks=pairs, parameters=_FEW_ITERATIONS)
    ball = even_sphere(100)
    on_sphere = SphereFunctions(SphereLayout(ball, ball.vertices), ball.vertices.T[:1])
    rotation_by_functions(on_sphere, on_sphere, np.ones(1))
    torn = np.arange(len(body.vertices))
    torn[:20] = torn[19::-1]
    continuous_map(abfm.PointMap.of_vertices(body, body, torn))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "concave.off"
        path.write_text(_CONCAVE)
        abfm.load_mesh(path)


if __name__ == "__main__":
    compile_kernels()

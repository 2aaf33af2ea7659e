"""What is drawn on surfaces besides colours: arrows of a field, paths, and points."""

from collections.abc import Callable, Sequence

import numpy as np

import abfm
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray
from abfm_viewer.appearance import material
from abfm_viewer.scene.arrow_mesh import arrow_mesh
from abfm_viewer.scene.opengl import ps

Rgb = Sequence[float]
Drawn = Callable[[FloatArray], FloatArray]  # places (..., 3) from the mesh's units to drawn ones, which radii are in
_FAST = 98  # percentile of the speeds shown that gets the full length
_SLOW, _LONGEST = 0.01, 1.25  # of it: below there is no arrow, and none is longer
_HIGH = 0.012  # of sqrt(area): what lies on a surface is hidden by it where it bends
_THICK = 0.0035


def evenly_spread(mesh: TriangleMesh, density: float) -> IntArray:
    """Faces spread over the surface: the largest in each cube of a grid whose size falls with the density, 0 to 1."""
    centers = mesh.vertices[mesh.faces].mean(axis=1) / mesh.length_scale
    density = min(max(density, 0.0), 1.0)
    side = 0.12 * (0.15 / 0.12) ** (1 - density) * 10 ** (-0.9 * density)
    by_size = np.argsort(-abfm.calculus.face_areas(mesh), kind="stable")
    cells = np.floor(centers[by_size] / side).astype(np.int64)
    return np.sort(by_size[np.unique(cells, axis=0, return_index=True)[1]])


def draw_arrows(
    name: str, mesh: TriangleMesh, velocity: FloatArray, length: float, density: float, drawn: Drawn, color: Rgb
) -> None:
    """Show a field (F, 3) that is not zero everywhere: `length` is that of the fast arrows."""
    speed = np.linalg.norm(velocity, axis=1)
    faces = evenly_spread(mesh, density)
    if not speed[faces].any():
        faces = np.array([speed.argmax()])
    fast = np.percentile(speed[faces][speed[faces] > 0], _FAST)  # the speed of slivers runs wild
    faces = faces[speed[faces] > _SLOW * fast]
    capped = np.minimum(1, _LONGEST * fast / speed[faces])
    vectors = (length / fast * capped)[:, None] * velocity[faces]
    lift = _HIGH * mesh.length_scale * abfm.calculus.face_normals(mesh)[faces]
    triangles = arrow_mesh(drawn(mesh.vertices[mesh.faces[faces]].mean(axis=1) + lift), vectors, _THICK)
    arrows = ps.register_surface_mesh(name, *triangles, smooth_shade=False, material=material.NAME, color=color[:3])
    arrows.reset_transform()  # polyscope remembers that of earlier structures of this name; likewise below


def draw_curves(name: str, paths: Sequence[FloatArray], drawn: Drawn, color: Rgb, radius: float) -> None:
    """Show paths, (K, 3) each."""
    nodes = np.concatenate(paths)
    counts = np.cumsum([len(path) for path in paths])
    edges = np.stack([np.arange(len(nodes) - 1), np.arange(1, len(nodes))], axis=1)
    edges = edges[~np.isin(edges[:, 1], counts)]
    network = ps.register_curve_network(name, drawn(nodes), edges, color=color[:3], material=material.NAME)
    network.reset_transform()
    network.set_radius(radius, relative=False)


def draw_points(name: str, positions: FloatArray, drawn: Drawn, color: Rgb, radius: float) -> None:
    """Show points (P, 3) as balls."""
    cloud = ps.register_point_cloud(name, drawn(positions), color=color[:3], material=material.NAME)
    cloud.reset_transform()
    cloud.set_radius(radius, relative=False)

"""What is drawn on surfaces besides colours: arrows of a field, lines, and points."""

from collections.abc import Sequence

import numpy as np

import abfm
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray
from abfm_viewer.appearance import material
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.ribbons import Course, Triangles, arrow_ribbons, course_of
from abfm_viewer.scene.viewport import viewport

Rgb = Sequence[float]
_FAST = 98  # percentile of the speeds shown that gets the full length
_SLOW, _LONGEST = 0.01, 1.25  # of it: below there is no arrow, and none is longer
_THICK = 0.0035  # half of an arrow's width


@per_mesh
def evenly_spread(mesh: TriangleMesh, density: float) -> IntArray:
    """Find the largest face in each cube of a grid, finer with the density, 0 to 1."""
    centers = mesh.vertices[mesh.faces].mean(axis=1) / mesh.length_scale
    density = min(max(density, 0.0), 1.0)
    side = 0.12 * (0.15 / 0.12) ** (1 - density) * 10 ** (-0.9 * density)
    by_size = np.argsort(-abfm.calculus.face_areas(mesh), kind="stable")
    cells = np.floor(centers[by_size] / side).astype(np.int64)
    return np.sort(by_size[np.unique(cells, axis=0, return_index=True)[1]])


def arrow_courses(
    mesh: TriangleMesh, velocity: FloatArray, length: float, density: float
) -> list[Course]:
    """Find the ways of the arrows of a field (F, 3): pieces of flow lines.

    The length is that of the fast ones.
    """
    speed = np.linalg.norm(velocity, axis=1)
    faces = evenly_spread(mesh, density)
    if not speed[faces].any():
        faces = np.array([speed.argmax()])
    if not speed[faces].any():
        return []
    fast = np.percentile(speed[faces][speed[faces] > 0], _FAST)  # the speed of slivers runs wild
    faces = faces[speed[faces] > _SLOW * fast]
    capped = velocity / np.maximum(fast, speed / _LONGEST)[:, None]
    starts = abfm.maps.SurfacePoints(mesh, faces, np.full((len(faces), 3), 1 / 3))
    lines = abfm.flow.flow_lines(mesh, capped, starts, length * mesh.length_scale)
    return [course_of(mesh, line) for line in lines if len(line.times) > 1]


def draw_arrows(name: str, mesh: TriangleMesh, courses: Sequence[Course], color: Rgb) -> None:
    """Show arrows that lie on a surface."""
    draw_ribbons(name, mesh, arrow_ribbons(courses, _THICK), color)


def draw_ribbons(name: str, mesh: TriangleMesh, triangles: Triangles, color: Rgb) -> None:
    """Show ribbons on a surface."""
    vertices, faces = triangles
    places = viewport(mesh).drawn(mesh.length_scale * vertices)
    look = {"smooth_shade": False, "material": material.NAME, "color": color[:3]}
    # none peeps over an edge
    ribbons = ps.register_surface_mesh(name, places, faces, back_face_policy="cull", **look)
    # polyscope remembers that of earlier structures of this name; likewise below
    ribbons.reset_transform()


def draw_points(
    name: str, mesh: TriangleMesh, positions: FloatArray, color: Rgb, radius: float
) -> None:
    """Show points (P, 3) of a surface as balls."""
    places = viewport(mesh).drawn(positions)
    cloud = ps.register_point_cloud(name, places, color=color[:3], material=material.NAME)
    cloud.reset_transform()
    cloud.set_radius(radius, relative=False)

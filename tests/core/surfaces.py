"""Small meshes of each topology; comparison of functions and fields, changes of meshes."""

import numpy as np
from scipy import sparse

from abfm.assets import asset_path
from abfm.calculus.operators import (
    Matrix,
    edge_areas,
    edge_gradient,
    face_areas,
    field_mass,
    vertex_areas,
)
from abfm.maps import SurfacePoints
from abfm.mesh import TriangleMesh, load_mesh
from tests.shapes import ellipsoid, hemisphere, open_cylinder, square, tetrahedron, torus

SURFACES = {
    "tetrahedron": tetrahedron(),
    "ellipsoid": ellipsoid(1, 1.0, 0.7, 0.4),
    "torus": torus(14, 9),
    "genus two": load_mesh(asset_path("eight.off")),
    "square": square(6),
    "hemisphere": hemisphere(5),
    "cylinder": open_cylinder(12, 4),
    "no inner vertices": open_cylinder(7, 1),
    "triangle": TriangleMesh([[0, 0, 0], [1, 0, 0], [0.2, 0.7, 0]], [[0, 1, 2]]),
}
LOOPS = {"torus": 2, "genus two": 4, "cylinder": 1, "no inner vertices": 1}
"""Independent loops of each surface (first Betti number), 0 if not listed."""


def random_function(mesh, seed=0):
    """Return normally distributed values on the vertices, (V,)."""
    return np.random.default_rng(seed).normal(size=len(mesh.vertices))


def random_points(mesh, count=500, seed=0):
    """Return points that are evenly distributed in random faces."""
    rng = np.random.default_rng(seed)
    faces = rng.integers(len(mesh.faces), size=count)
    return SurfacePoints(mesh, faces, rng.dirichlet(np.ones(3), size=count))


def edge_divergence(mesh):
    """Return the matrix of the divergence at edges, (E, 2F): the jump of the normal flux."""
    mass = sparse.diags_array(1 / edge_areas(mesh))
    return Matrix(-mass @ edge_gradient(mesh).T @ field_mass(mesh))


def norm(mesh, values):
    """Return the L2 norm of a function (V,), or of values of faces, (F,) or (F, n)."""
    areas = vertex_areas(mesh) if len(values) == len(mesh.vertices) else face_areas(mesh)
    return float(np.sqrt((areas * (values.reshape(len(values), -1) ** 2).sum(axis=1)).sum()))


def relative_error(mesh, values, exact):
    """Return the L2 norm of ``values - exact``, divided by the L2 norm of ``exact``."""
    return norm(mesh, values - exact) / norm(mesh, exact)


def last_order(errors):
    """Return the order p in ``error ~ edge length^p`` of the last two meshes. Lengths halve."""
    coarse, fine = np.asarray(errors)[-2:]
    return np.asarray(np.log2(coarse / fine))


def moved(mesh, rotation, scale=1.0):
    """Return the mesh rotated by a matrix (3, 3), scaled and translated."""
    return TriangleMesh(scale * mesh.vertices @ rotation.T + [3.0, -1.0, 2.0], mesh.faces)


def renumbered(mesh, seed):
    """Return the mesh in another order of vertices, faces and corners, and the old numbers."""
    rng = np.random.default_rng(seed)
    vertices, faces = rng.permutation(len(mesh.vertices)), rng.permutation(len(mesh.faces))
    corners = (np.arange(3) + rng.integers(3, size=len(faces))[:, None]) % 3
    numbers = np.argsort(vertices)[np.take_along_axis(mesh.faces[faces], corners, axis=1)]
    return TriangleMesh(mesh.vertices[vertices], numbers), vertices, faces

"""Generated meshes for all tests, oriented outward (or upward)."""

import numpy as np
import trimesh

from abfm.mesh import TriangleMesh


def icosphere(subdivisions, radius=1.0):
    """Return a sphere of 10 * 4**subdivisions + 2 vertices with nearly even triangles."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return TriangleMesh(sphere.vertices, sphere.faces)


def ellipsoid(subdivisions, a, b, c):
    """Return an icosphere scaled to the half-axes a, b, c."""
    sphere = icosphere(subdivisions)
    return TriangleMesh(sphere.vertices * [a, b, c], sphere.faces)


def with_loose_vertex(mesh):
    """Return the mesh of a file with one additional vertex 5, which no face uses."""
    return TriangleMesh(np.insert(mesh.vertices, 5, 9.0, axis=0), mesh.faces + (mesh.faces >= 5))


def with_thin_triangles(mesh):
    """Return the mesh with an additional vertex in each face, close to the middle of an edge."""
    weights = np.array([0.01, 0.495, 0.495])
    added = np.einsum("c,fcx->fx", weights, mesh.vertices[mesh.faces])
    first, second, third = mesh.faces.T
    new = len(mesh.vertices) + np.arange(len(mesh.faces))
    faces = ([first, second, new], [second, third, new], [third, first, new])
    faces = np.concatenate([np.stack(each, axis=1) for each in faces])
    return TriangleMesh(np.concatenate([mesh.vertices, added]), faces)


def tetrahedron():
    """Return a regular tetrahedron with edge length 2 sqrt(2), the smallest closed mesh."""
    vertices = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    return TriangleMesh(vertices, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def torus(n, m, R=1.0, r=0.4):
    """Return a torus about the z axis.

    n vertices lie on the circle of radius R, and m around the tube of radius r.
    """
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    ring = R + r * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), r * np.sin(v)], axis=-1)
    return TriangleMesh(vertices.reshape(-1, 3), _grid_faces(n, m, True, True))


def square(n):
    """Return the unit square in the plane z = 0, with n x n cells of uneven size.

    Diagonals alternate. The unevenness is smooth and leaves no symmetry. For even n, no face has
    two boundary edges. Boundary vertices lie on the sides.
    """
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    x, y = (
        x + 0.08 * np.sin(np.pi * x) * np.cos(2 * y + 0.3),
        y + 0.06 * np.sin(np.pi * y) * np.sin(3 * x + 0.5),
    )
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return TriangleMesh(vertices, _grid_faces(n + 1, n + 1))


def disc(n):
    """Return the unit disc in the plane z = 0; ring k of n has 6 k vertices."""
    return _capped_rings(n, lambda s: (s, np.zeros_like(s)))


def hemisphere(n):
    """Return the upper half of the unit sphere; ring k of n has 6 k vertices.

    The boundary is at z = 0.
    """
    return _capped_rings(n, lambda s: (np.sin(np.pi / 2 * s), np.cos(np.pi / 2 * s)))


def open_cylinder(n, m, radius=1.0, height=2.0):
    """Return a cylinder about the z axis without caps: n vertices around, m + 1 rings."""
    u, z = np.meshgrid(2 * np.pi * np.arange(n) / n, np.linspace(0, height, m + 1), indexing="ij")
    vertices = np.stack([radius * np.cos(u), radius * np.sin(u), z], axis=-1).reshape(-1, 3)
    return TriangleMesh(vertices, _grid_faces(n, m + 1, True))


def moebius_arrays(n):
    """Return the vertices (2n, 3) and faces (2n, 3) of a Moebius strip.

    It cannot be a TriangleMesh, as it is not orientable.
    """
    u = 2 * np.pi * np.arange(n) / n
    spokes = [np.cos(u / 2) * np.cos(u), np.cos(u / 2) * np.sin(u), np.sin(u / 2)]
    across = 0.3 * np.stack(spokes, axis=-1)
    centre = np.stack([np.cos(u), np.sin(u), np.zeros(n)], axis=-1)
    left, right = np.arange(n), np.arange(n) + n
    next_left, next_right = np.append(left[1:], right[0]), np.append(right[1:], left[0])
    halves = [left, right, next_left], [right, next_right, next_left]
    faces = np.concatenate([np.stack(half, axis=1) for half in halves])
    return np.concatenate([centre - across, centre + across]), faces


def _grid_faces(n, m, wrap_first=False, wrap_second=False):
    """Return two triangles for each cell of an n x m vertex grid (vertex i * m + j).

    Diagonals alternate.
    """
    i, j = np.meshgrid(
        np.arange(n if wrap_first else n - 1), np.arange(m if wrap_second else m - 1), indexing="ij"
    )
    i_next, j_next = (i + 1) % n, (j + 1) % m
    a, b, c, d = i * m + j, i_next * m + j, i_next * m + j_next, i * m + j_next
    even = ((i + j) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    return np.stack([first, second], axis=-2).reshape(-1, 3)


def _capped_rings(n, profile):
    """Return a surface of revolution about the z axis.

    Ring k has 6 k vertices at ``profile(k / n)`` = (distance, height).
    """
    rings = np.repeat(np.arange(1, n + 1), 6 * np.arange(1, n + 1))
    angle = 2 * np.pi * np.concatenate([np.arange(6 * k) for k in range(1, n + 1)]) / (6 * rings)
    distance, height = profile(rings / n)
    vertices = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=-1)
    apex = [[0.0, 0.0, profile(np.zeros(1))[1][0]]]
    faces = []
    for k in range(1, n + 1):
        start, inside = 1 + 3 * k * (k - 1), 1 + 3 * (k - 1) * (k - 2)
        for sector in range(6):
            for step in range(k):
                outer = [start + (sector * k + step + s) % (6 * k) for s in (0, 1)]
                inner = [0, 0]
                if k > 1:
                    place = sector * (k - 1) + step
                    inner = [inside + (place + s) % (6 * (k - 1)) for s in (-1, 0)]
                faces.append([outer[0], outer[1], inner[1]])
                if step > 0:
                    faces.append([outer[0], inner[1], inner[0]])
    return TriangleMesh(np.concatenate([apex, vertices]), faces)

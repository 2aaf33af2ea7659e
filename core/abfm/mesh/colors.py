"""Readers of the colours of a surface: images with texture coordinates, and colours of vertices."""

from __future__ import annotations

import os
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from abfm.errors import MeshError, one_line
from abfm.mesh.files import Readers, read_contents
from abfm.mesh.readers.colored import WHITE, ColoredFaces, Material, colored_ply
from abfm.mesh.readers.gltf_colors import colored_gltf
from abfm.mesh.readers.obj_colors import colored_obj
from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.reading import Format, read_bytes
from abfm.types import FloatArray, IntArray

COLOR_READERS: Readers[ColoredFaces] = {
    Format.OBJ: colored_obj,
    Format.GLB: colored_gltf,
    Format.GLTF: colored_gltf,
    Format.PLY: colored_ply,
}
"""The reader of each file format."""
# Largest distance between equal vertices of file and surface, as a fraction of sqrt(area) and of
# the largest coordinate.
_POSITION_TOLERANCE = 1e-5
_SINGLE_PRECISION = 2e-7


class SurfaceColors(NamedTuple):
    """Colours of the faces of a surface, see `load_colors`."""

    # (F, 3, 2), of the corners to the right and up, 0 to 1 over the image; NaN without an image
    coordinates: FloatArray
    colors: FloatArray  # (F, 3, 4), factors of red, green, blue and opacity, 0 to 1
    owners: IntArray  # (F,), number of the material of each face
    materials: tuple[Material, ...]  # each image is the bytes of its file


def load_colors(
    path: str | os.PathLike[str], mesh: TriangleMesh, image: str | os.PathLike[str] | None = None
) -> SurfaceColors:
    """Read the texture or the vertex colours of a surface from a file (obj, glb, gltf, ply).

    The vertices of the file may have another order, and may repeat at the seams of a texture. The
    faces of the surface are identified in the file by the positions of their corners. If the
    surface was moved, they are identified by their vertex numbers. The file may have further faces.
    ``image`` replaces the image that the file refers to.

    Raises MeshError if the file cannot be read, belongs to another surface, or has no colours.
    """
    name, readers = one_line(path), dict(COLOR_READERS)
    if image is not None:
        readers[Format.OBJ] = partial(colored_obj, has_materials=False)
    try:
        found = read_contents(path, readers, "file with colours")
        if image is not None:
            material = Material(_bytes_of(image), alpha_mode="BLEND")
            found = found._replace(materials=(material,), owners=np.zeros_like(found.owners))
        rows, corners = _rows_of(mesh, found)
        return _of_rows(found, rows, corners)
    except MeshError as error:
        raise MeshError(f"{name}: {error}") from error


def _bytes_of(image: str | os.PathLike[str]) -> bytes:
    try:
        return read_bytes(image)
    except OSError as error:
        raise MeshError(f"the image {one_line(image)} cannot be read: {one_line(error)}") from None


def _of_rows(found: ColoredFaces, rows: IntArray, corners: IntArray) -> SurfaceColors:
    """Return the colours of the faces ``rows`` (n,) of a file.

    ``corners`` (n, 3) is the order in which the corners of each face are returned.
    """
    used, owners = np.unique(found.owners[rows], return_inverse=True)
    materials = tuple(found.materials[k] for k in used)
    places, colors = (part[rows[:, None], corners] for part in (found.coordinates, found.colors))
    has_image = np.array([each.image is not None for each in materials])[owners]
    missing = has_image & ~np.isfinite(places).all(axis=(1, 2))
    if missing.any():
        raise MeshError(
            f"{missing.sum()} of {len(missing)} faces have an image but no texture coordinates "
            f"(for example face {rows[missing][0]}, counting from 0). Unwrap them in the program "
            "that made the file"
        )
    is_white = (colors == 1).all() and all(each.color == WHITE for each in materials)
    if is_white and not has_image.any():
        raise MeshError(
            "the file refers to no image and has no vertex colours. Use a file with a texture, or "
            "choose the image as well"
        )
    return SurfaceColors(places, colors, owners, materials)


def _rows_of(mesh: TriangleMesh, found: ColoredFaces) -> tuple[IntArray, IntArray]:
    """Return, for each face of the mesh, the face of the file, (F,), and its corners, (F, 3).

    The corners are in the order of the mesh. Raises MeshError if a face is not in the file.
    """
    if not np.isfinite(found.vertices).all():
        raise MeshError("the file has coordinates that are not finite. Correct them")
    places, place_of_vertex = np.unique(mesh.vertices, axis=0, return_inverse=True)
    distances, nearest = KDTree(places).query(found.vertices)
    extent = float(np.abs(mesh.vertices).max())
    same = distances <= _POSITION_TOLERANCE * mesh.length_scale + _SINGLE_PRECISION * extent
    by_place = place_of_vertex.reshape(-1)[mesh.faces], np.where(same, nearest, -1)[found.faces]
    rows = _equal_faces(*by_place)
    if (rows < 0).any() and len(found.vertices) == mesh.file_vertex_count:
        by_number = mesh.faces, mesh.local_vertices(found.faces)
        if (_equal_faces(*by_number) >= 0).all():
            by_place, rows = by_number, _equal_faces(*by_number)
    if (rows < 0).any():
        raise MeshError(
            f"the file shows another surface: {np.sum(rows < 0)} of the {len(rows)} faces of the "
            f"mesh are not among the {len(found.faces)} faces of the file. Use the file that the "
            "mesh was read from, or one with the same points"
        )
    of_mesh, of_file = by_place[0], by_place[1][rows]
    return rows, np.argmax(of_mesh[:, :, None] == of_file[:, None, :], axis=2)


def _equal_faces(faces: IntArray, others: IntArray) -> IntArray:
    """Return for each face the index of the first of the ``others`` with the same corners, or -1.

    The corners may be in any order.
    """
    both = np.sort(np.concatenate([faces, others]), axis=1)
    _, groups = np.unique(both, axis=0, return_inverse=True)
    first = np.full(int(groups.max()) + 1, -1)
    numbers = np.arange(len(others))[::-1]
    first[groups.reshape(-1)[len(faces) :][::-1]] = numbers
    return first[groups.reshape(-1)[: len(faces)]]

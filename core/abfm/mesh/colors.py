"""Reading what colours a surface from a file that shows it: images, and where they lie on it."""

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
"""By the format of the file."""
# how far a vertex may lie from itself on the surface: in sqrt(area), and in its coordinates
_POSITION_TOLERANCE = 1e-5
_SINGLE_PRECISION = 2e-7


class SurfaceColors(NamedTuple):
    """What gives the faces of a surface their colours; see `load_colors`.

    Attributes
    ----------
    coordinates : (F, 3, 2) array
        Of each face's corners, to the right and up, from 0 to 1 over the image; NaN where there
        are none, and the material has no image.
    colors : (F, 3, 4) array
        Which the material's are multiplied by: red, green, blue and opacity, each from 0 to 1.
    owners : (F,) array of int
        The material of each face.
    materials : tuple of Material
        Their images are the bytes of files.
    """

    coordinates: FloatArray
    colors: FloatArray
    owners: IntArray
    materials: tuple[Material, ...]


def load_colors(
    path: str | os.PathLike[str], mesh: TriangleMesh, image: str | os.PathLike[str] | None = None
) -> SurfaceColors:
    """Read the texture, or the colours of vertices, that a file (obj, glb, gltf, ply) gives a
    surface.

    The file may have other vertices, as where the texture has a seam, in another order: faces are
    known by the places of their corners; or else by their numbers, if the surface lies elsewhere.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface. The file may have further faces.
    image : path, optional
        The image, whatever the file names.

    Raises
    ------
    MeshError
        One line that begins with the file's name: why it cannot be read, or that it is of another
        surface, or gives it no colours.
    """
    name, readers = one_line(path), dict(COLOR_READERS)
    if image is not None:
        readers[Format.OBJ] = partial(colored_obj, has_materials=False)
    try:
        found = read_contents(path, readers, "file with colours")
        if image is not None:
            given = Material(_bytes_of(image), alpha_mode="BLEND")
            found = found._replace(materials=(given,), owners=np.zeros_like(found.owners))
        rows, corners = _rows_of(mesh, found)
        return _of_rows(found, rows, corners)
    except MeshError as error:
        raise MeshError(f"{name}: {error}") from error


def _bytes_of(image: str | os.PathLike[str]) -> bytes:
    try:
        return read_bytes(image)
    except OSError as error:
        raise MeshError(f"the image {one_line(image)}: {one_line(error)}") from None


def _of_rows(found: ColoredFaces, rows: IntArray, corners: IntArray) -> SurfaceColors:
    """Return what faces (rows) of the file have, at their ``corners`` (n, 3)."""
    known, owners = np.unique(found.owners[rows], return_inverse=True)
    materials = tuple(found.materials[k] for k in known)
    places, colors = (part[rows[:, None], corners] for part in (found.coordinates, found.colors))
    has_image = np.array([each.image is not None for each in materials])[owners]
    lost = has_image & ~np.isfinite(places).all(axis=(1, 2))
    if lost.any():
        raise MeshError(
            f"{lost.sum()} of {len(lost)} faces have an image and no texture coordinates (for "
            f"example face {rows[lost][0]}, counting from 0): unwrap them in the program that "
            "made it"
        )
    is_white = (colors == 1).all() and all(each.color == WHITE for each in materials)
    if is_white and not has_image.any():
        raise MeshError(
            "it names no image and has no colours of vertices: give a textured file, or the image"
        )
    return SurfaceColors(places, colors, owners, materials)


def _rows_of(mesh: TriangleMesh, found: ColoredFaces) -> tuple[IntArray, IntArray]:
    """Return which face of the file each one of the surface is, (F,), and its corners, (F, 3)."""
    if not np.isfinite(found.vertices).all():
        raise MeshError("it has coordinates that are not finite: correct them")
    places, own = np.unique(mesh.vertices, axis=0, return_inverse=True)
    distances, nearest = KDTree(places).query(found.vertices)
    reach = float(np.abs(mesh.vertices).max())
    same = distances <= _POSITION_TOLERANCE * mesh.length_scale + _SINGLE_PRECISION * reach
    by_place = own.reshape(-1)[mesh.faces], np.where(same, nearest, -1)[found.faces]
    rows = _equal_faces(*by_place)
    if (rows < 0).any() and len(found.vertices) == mesh.file_vertex_count:
        by_number = mesh.faces, mesh.local_vertices(found.faces)
        if (_equal_faces(*by_number) >= 0).all():
            by_place, rows = by_number, _equal_faces(*by_number)
    if (rows < 0).any():
        raise MeshError(
            f"it is of another surface: of the {len(rows)} faces that are to be coloured, "
            f"{np.sum(rows < 0)} are not among its {len(found.faces)}; give the file that the "
            "surface was read from, or one with the same points"
        )
    ours, theirs = by_place[0], by_place[1][rows]
    return rows, np.argmax(ours[:, :, None] == theirs[:, None, :], axis=2)


def _equal_faces(ours: IntArray, theirs: IntArray) -> IntArray:
    """Return for each of our faces (n, 3) the first of theirs with the same corners, or -1."""
    both = np.sort(np.concatenate([ours, theirs]), axis=1)
    _, groups = np.unique(both, axis=0, return_inverse=True)
    first = np.full(int(groups.max()) + 1, -1)
    numbers = np.arange(len(theirs))[::-1]
    first[groups.reshape(-1)[len(ours) :][::-1]] = numbers
    return first[groups.reshape(-1)[: len(ours)]]

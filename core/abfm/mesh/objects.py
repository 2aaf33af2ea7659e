"""Meshes of other libraries, recognized by their attributes; no library is imported."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np

from abfm.errors import brief, one_line
from abfm.mesh.readers.brain import read_gifti
from abfm.mesh.readers.contents import FileContents, split_polygons
from abfm.reading import (
    HEMISPHERES,
    Format,
    Opened,
    polygons_of_cells,
    split_lists,
    triangles_of_strips,
)
from abfm.types import IntArray

MeshLike: TypeAlias = Any
"""A `TriangleMesh`, a file name, a pair (vertices, faces), or a mesh of trimesh, PyVista, meshio,
Open3D, PyMeshLab, vedo, LaPy, BrainSpace, nilearn or nibabel."""
ACCEPTED_TYPES = (
    "a TriangleMesh, a file name, a pair (vertices, faces), or a mesh of trimesh, PyVista, meshio, "
    "Open3D, PyMeshLab, vedo, LaPy, BrainSpace, nilearn or nibabel"
)
_FACES = ("triangle", "quad")
_SIDES = {word: side for side, word in HEMISPHERES.items()}
_DRAWN_KINDS = ("vertex", "line", "line3", "polyline")


def has(source: Any, *names: str) -> bool:
    """Return whether an object, not a class, has all these attributes, and access does not fail."""
    try:
        return not isinstance(source, type) and all(hasattr(source, name) for name in names)
    except Exception:
        return False


def contents_of(source: Any, hemisphere: str = "") -> FileContents:
    """Return the vertices and faces of an object, in the order of the object.

    ``hemisphere`` chooses the part of a nilearn object. Raises ValueError if the object is not a
    mesh.
    """
    if isinstance(source, tuple | list):
        if len(source) != 2:
            raise ValueError(
                f"a tuple or list of {len(source)} items is not a mesh; expected a pair (vertices, "
                "faces)"
            )
        return FileContents(*source)
    if parts := parts_of(source):
        if len(parts) == 1:
            hemisphere = hemisphere or _SIDES.get(next(iter(parts)), "")
        source = part_of(parts, hemisphere)
    for names, read in _READERS.items():
        if has(source, *names):
            found = read(source)
            return found._replace(side=hemisphere or found.side)
    raise ValueError(
        f"an object of type {one_line(type(source).__name__, 60)} is not a mesh; expected "
        f"{ACCEPTED_TYPES}"
    )


def parts_of(source: Any) -> Mapping[str, Any] | None:
    """Return the parts of a nilearn ``SurfaceImage`` or ``PolyMesh``; None for other objects."""
    mesh = source.mesh if has(source, "mesh", "data") else source
    return mesh.parts if has(mesh, "parts") else None


def part_of(parts: Mapping[str, Any], hemisphere: str) -> Any:
    """Return the part of a nilearn object for a hemisphere, or its only part.

    Raises ValueError if the part is missing, or if there are several parts and none is chosen.
    """
    found = dict(parts)
    if not hemisphere and len(found) == 1:
        return next(iter(found.values()))
    if not hemisphere:
        raise ValueError(
            'the object has two hemispheres. Choose one: abfm.load_mesh(..., hemisphere="L") or "R"'
        )
    part = HEMISPHERES.get(hemisphere)
    if part not in found:
        raise ValueError(
            f"hemisphere is {brief(hemisphere)}, but the object has {brief(list(found))}"
        )
    return found[part]


def _of_poly_data(source: Any) -> FileContents:
    """Read polygons and triangle strips, each stored after the number of its corners."""
    sizes, corners = _lists(source.faces, "faces")
    triangles = triangles_of_strips(*_lists(source.strips, "strips"))
    all_sizes = [sizes, np.full(len(triangles), 3)]
    return _split(source.points, all_sizes, [corners, triangles.ravel()])


def _of_grid(source: Any) -> FileContents:
    """Read the polygons of a PyVista ``UnstructuredGrid``, with its order of vertices."""
    types = np.asarray(source.celltypes).astype(np.int64)
    sizes, corners = polygons_of_cells(*_lists(source.cells, "cells"), types)
    return _split(source.points, [sizes], [corners])


def _of_adapter(source: Any) -> FileContents:
    """Read the polygons of a BrainSpace surface, or of the NumPy adapter of VTK."""
    sizes, corners = _lists(source.Polygons, "polygons")
    return _split(source.Points, [sizes], [corners])


def _lists(source: Any, name: str) -> tuple[IntArray, IntArray]:
    numbers = np.asarray([] if source is None else source).astype(np.int64).ravel()
    try:
        return split_lists(numbers)
    except ValueError:
        raise ValueError(
            f"its list of {name} ends too early; expected each length followed by as many corners"
        ) from None


def _of_cells(source: Any) -> FileContents:
    """Read the triangles, quadrilaterals and polygons of a mesh of meshio or vedo."""
    blocks = [("polygon", source.cells)]  # a mesh of vedo
    if all(has(block, "type", "data") for block in source.cells):
        blocks = [(str(block.type), block.data) for block in source.cells]
    sizes, corners = [], []
    for kind, data in blocks:
        if kind in _DRAWN_KINDS:
            continue
        if kind not in _FACES and not kind.startswith("polygon"):
            raise ValueError(
                f"it has cells of type {brief(kind)}; expected triangles, quads or polygons. "
                "Extract the surface of a volume first"
            )
        sizes.append(np.array([len(row) for row in data], dtype=np.int64))
        corners.append(np.concatenate([np.zeros(0, dtype=np.int64), *data]))
    points = np.asarray(source.points)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return _split(points, sizes, corners)


def _split(points: Any, sizes: list[IntArray], corners: list[IntArray]) -> FileContents:
    if not sum(map(len, sizes)):
        raise ValueError("it has no faces; expected triangles")
    points = np.asarray(points, dtype=np.float64)
    return split_polygons(points, np.concatenate(sizes), np.concatenate(corners).astype(np.int64))


def _of_scene(source: Any) -> NoReturn:
    raise ValueError("a scene is not a mesh. Use the mesh that its to_mesh() returns")


_READERS: dict[tuple[str, ...], Callable[[Any], FileContents]] = {
    ("coordinates", "faces"): lambda part: FileContents(part.coordinates, part.faces),
    ("darrays", "to_bytes"): lambda image: read_gifti(
        Opened(Path("the image"), Format.GIFTI, image.to_bytes(mode="force"))
    ),
    ("points", "faces", "strips"): _of_poly_data,
    ("points", "cells", "celltypes"): _of_grid,
    ("points", "cells"): _of_cells,
    ("geometry", "to_mesh"): _of_scene,
    ("vertices", "faces"): lambda mesh: FileContents(mesh.vertices, mesh.faces),
    ("vertices", "triangles"): lambda mesh: FileContents(mesh.vertices, mesh.triangles),
    ("vertex", "triangle", "to_legacy"): lambda mesh: contents_of(mesh.to_legacy()),
    ("vertex_matrix", "face_matrix"): lambda mesh: FileContents(
        mesh.vertex_matrix(), mesh.face_matrix()
    ),
    ("Points", "Polygons"): _of_adapter,
    ("v", "t"): lambda mesh: FileContents(mesh.v, mesh.t),
}
"""Reader of objects with these attributes: a part of nilearn's PolyMesh, nibabel, PyVista, meshio
and vedo, trimesh, Open3D, PyMeshLab, BrainSpace, LaPy."""

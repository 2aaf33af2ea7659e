"""Reading mesh files."""

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from abfm.errors import MeshError, one_line
from abfm.mesh.readers.contents import FileContents
from abfm.mesh.readers.gltf import read_gltf
from abfm.mesh.readers.plain import read_obj, read_off, read_stl
from abfm.mesh.readers.ply import read_ply
from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.reading import freesurfer_kind, freesurfer_surface, gifti_arrays, open_plain
from abfm.workers.progress import step

Contents = TypeVar("Contents")
_LONGEST_NAME = 300


def read_gifti(path: Path) -> FileContents:
    """Read the point set and the triangles of a GIFTI surface file."""
    arrays = gifti_arrays(path)
    points = [array.values for array in arrays if array.intent == "NIFTI_INTENT_POINTSET"]
    triangles = [array.values for array in arrays if array.intent == "NIFTI_INTENT_TRIANGLE"]
    if len(points) != 1 or len(triangles) != 1:
        raise ValueError(
            f"it has {len(points)} point sets and {len(triangles)} triangle arrays instead of one "
            "of each: give a surface file (.surf.gii)"
        )
    return FileContents(np.asarray(points[0], dtype=np.float64), triangles[0])


def read_freesurfer(path: Path) -> FileContents:
    """Read a FreeSurfer surface of triangles, such as ``lh.white``, in surface RAS as it is."""
    return FileContents(*freesurfer_surface(path))


READERS: dict[str, Callable[[Path], FileContents]] = {
    ".obj": read_obj,
    ".off": read_off,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".gii": read_gifti,
    ".gii.gz": read_gifti,
}
"""By endings of names."""
_NO_MESHES = {
    ".annot": "it holds labels of vertices",
    ".label": "it holds a list of vertices",
    "values": "it holds values at vertices, as FreeSurfer writes them",
}


def load_mesh(
    path: str | os.PathLike[str],
    *,
    merge: bool | float | None = None,
    clean: bool = False,
    hemisphere: str | None = None,
    largest_component: bool = False,
) -> TriangleMesh:
    """Read a triangle mesh from a file: obj, off, ply, stl, glb, gltf, gii or FreeSurfer's.

    Vertices keep the file's order and count, unused ones included; only STL and glTF, which repeat
    vertices, are merged by position, with a message. Polygons are split into triangles. Surfaces
    of FreeSurfer, such as ``lh.white``, are known by their first bytes, and keep the coordinates
    of the file: surface RAS, to which ``cras`` is not added, as in nibabel.

    Parameters
    ----------
    path : path
        The ending of its name says the format, or else how the file begins.
    merge : bool or float, optional
        Make vertices one that are at most this distance apart, in the file's unit, as where a
        texture has a seam: the first of them stays where it is. A distance of an edge's length is
        refused. True takes 1e-6 of the diagonal of the bounding box, or less where edges are short.
    clean : bool
        Remove repeated faces, and sheets that hang on a surface of at least their area. Remove
        faces without area: join their ends if these are close, or else split their neighbours, so
        that no hole is left. What cannot be cleaned so is refused.
    hemisphere : {"L", "R"}, optional
        Of a surface with both hemispheres, next to each other along x, keep one; L has the smaller
        x. A surface in one piece is kept as it is.
    largest_component : bool
        Of several components keep the one with the largest area instead of refusing the mesh.

    Notes
    -----
    Options apply in this order, and `TriangleMesh.messages` reports every change with a count and
    an example. Values given for each vertex of the file fit all the same: see
    `TriangleMesh.restrict`, and `TriangleMesh.on_file` for results.

    Raises
    ------
    MeshError
        One line that begins with the file's name: why it cannot be read, or its mesh be used.
    """
    file, name = Path(path), one_line(path, _LONGEST_NAME)
    ending = next((ending for ending in READERS if file.name.lower().endswith(ending)), None)
    form = ending or _form_by_beginning(file, name)
    try:
        reader = READERS.get(form, read_freesurfer)
        vertices, faces, messages = read_contents(file, form, reader)
        return TriangleMesh(
            vertices,
            faces,
            merge=merge,
            clean=clean,
            hemisphere=hemisphere,
            largest_component=largest_component,
            messages=messages,
        )
    except MemoryError as error:
        raise MeshError(
            f"{name}: the mesh does not fit into memory: close other programs, or coarsen it"
        ) from error
    except MeshError as error:
        raise error.of(name) from error


def _form_by_beginning(file: Path, name: str) -> str:
    """Return the format of a file whose name does not say it, or raise a MeshError."""
    try:
        kind = freesurfer_kind(file)
    except OSError:
        kind = "surface"  # reading it will tell why it cannot be read
    if kind in ("surface", "quadrangles"):
        return "a FreeSurfer surface"
    no_mesh = _NO_MESHES.get(kind or file.suffix.lower())
    if no_mesh:
        raise MeshError(f"{name}: {no_mesh}, and no mesh: give a surface, such as lh.white")
    known = f"{', '.join(READERS)}, and FreeSurfer's surfaces by how they begin"
    raise MeshError(f"{name}: the format is not known from the name's ending; known are {known}")


def read_contents(file: Path, form: str, reader: Callable[[Path], Contents]) -> Contents:
    """Return the contents of the file, or a MeshError: readers may raise anything on a bad file."""
    try:
        with open_plain(file) as opened:
            size = opened.seek(0, os.SEEK_END)
        if size == 0:
            raise ValueError("the file is empty")
        with step(f"reading {form}", size), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return reader(file)
    except MemoryError:
        raise
    except FileNotFoundError as error:
        missing = f"a file that it names is missing: {one_line(error.filename)}"
        raise MeshError(missing if os.path.exists(file) else "there is no such file") from error
    except IsADirectoryError as error:
        folder, named = "this is a folder, not a mesh file", "a file that it names is a folder: "
        raise MeshError(folder if file.is_dir() else f"{named}correct the name") from error
    except Exception as error:
        raise MeshError(f"cannot be read as {form}: {one_line(error)}") from error

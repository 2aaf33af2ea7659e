"""Reading mesh files."""

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from abfm.errors import MeshError, ParameterError, brief, one_line
from abfm.mesh.objects import PARTS, MeshLike, contents_of
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
    mesh: MeshLike, largest_component: bool = False, hemisphere: str = ""
) -> TriangleMesh:
    """Read a triangle mesh from a file, or make one of a mesh of another library.

    Vertices keep the order and count of the file or object, unused ones included; only STL and
    glTF, which repeat vertices, are merged by position, with a message. Polygons are split into
    triangles. Surfaces of FreeSurfer, such as ``lh.white``, are known by their first bytes, and
    keep the coordinates of the file: surface RAS, to which ``cras`` is not added, as in nibabel.

    Parameters
    ----------
    mesh : path or object
        A file: obj, off, ply, stl, glb, gltf, gii or FreeSurfer's; the ending of its name gives the
        format, or else its first bytes. Or a pair (vertices, faces), a ``trimesh.Trimesh``, PyVista
        ``PolyData``, a meshio mesh, nilearn's ``SurfaceImage`` or ``PolyMesh``, a nibabel GIFTI
        image, or a `TriangleMesh`, which is returned as it is.
    largest_component : bool
        Of several components keep the one with the largest area instead of refusing the mesh.
    hemisphere : str
        "L" or "R": the part of nilearn's objects; empty if there is only one.

    Raises
    ------
    MeshError
        One line that begins with the file's name: why it cannot be read, or its mesh be used.
    """
    if isinstance(mesh, TriangleMesh):
        return mesh
    if not isinstance(mesh, str | os.PathLike):
        return _of_object(mesh, "mesh", largest_component, hemisphere)
    file, name = Path(mesh), one_line(mesh, _LONGEST_NAME)
    ending = next((ending for ending in READERS if file.name.lower().endswith(ending)), None)
    form = ending or _form_by_beginning(file, name)
    try:
        reader = READERS.get(form, read_freesurfer)
        vertices, faces, messages = read_contents(file, form, reader)
        return TriangleMesh(vertices, faces, largest_component=largest_component, messages=messages)
    except MemoryError as error:
        raise MeshError(
            f"{name}: the mesh does not fit into memory: close other programs, or coarsen it"
        ) from error
    except MeshError as error:
        raise MeshError(f"{name}: {error}") from error


def as_mesh(given: MeshLike, name: str = "mesh") -> TriangleMesh:
    """Return a mesh as it is, or what `load_mesh` makes of anything else.

    Raises
    ------
    MeshError
        If it makes no mesh; the message begins with the file's name or with ``name``.
    """
    if isinstance(given, TriangleMesh):
        return given
    if isinstance(given, str | os.PathLike):
        return load_mesh(given)
    return _of_object(given, name, False, "")


def as_meshes(a: MeshLike, b: MeshLike) -> tuple[TriangleMesh, TriangleMesh]:
    """Return `as_mesh` of two surfaces, one mesh if they are the same object."""
    mesh = as_mesh(a, "a")
    return mesh, mesh if a is b else as_mesh(b, "b")


def _of_object(given: object, name: str, largest_component: bool, hemisphere: str) -> TriangleMesh:
    if hemisphere not in ("", *PARTS):
        raise ParameterError(f"hemisphere is {brief(hemisphere)}; expected L or R")
    try:
        vertices, faces, messages = contents_of(given, hemisphere)
        return TriangleMesh(vertices, faces, largest_component=largest_component, messages=messages)
    except MeshError as error:
        raise MeshError(f"{name}: {error}") from error
    except Exception as error:  # the objects are not ours, and may raise anything
        raise MeshError(f"{name} cannot be used: {one_line(error, 400)}") from error


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

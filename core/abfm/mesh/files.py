"""Reading mesh files."""

import os
import warnings
from collections.abc import Callable, Mapping
from typing import TypeVar, Unpack

from abfm.errors import MeshError, ParameterError, one_line
from abfm.mesh.objects import MeshLike, contents_of, parts_of
from abfm.mesh.options import MeshKeywords
from abfm.mesh.readers.brain import (
    read_ascii_surface,
    read_gifti,
    read_mni_obj,
    read_quadrangles,
    read_surface,
)
from abfm.mesh.readers.contents import FileContents, split_polygons
from abfm.mesh.readers.gltf import read_gltf
from abfm.mesh.readers.off import read_off
from abfm.mesh.readers.plain import read_obj, read_stl
from abfm.mesh.readers.ply import read_ply
from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.reading import (
    ENDINGS,
    HEMISPHERES,
    STRUCTURES,
    Format,
    Opened,
    named_side,
    open_file,
    vtk_contents,
)
from abfm.workers.progress import step

Contents = TypeVar("Contents")
Readers = Mapping[Format, Callable[[Opened], Contents]]
_NAME_LENGTH_MAX = 300


def read_vtk(opened: Opened) -> FileContents:
    """Read the points and the polygons of a file of VTK."""
    file = vtk_contents(opened)
    return split_polygons(file.points, *file.polygons())


READERS: Readers[FileContents] = {
    Format.OBJ: read_obj,
    Format.OFF: read_off,
    Format.PLY: read_ply,
    Format.STL: read_stl,
    Format.GLB: read_gltf,
    Format.GLTF: read_gltf,
    Format.GIFTI: read_gifti,
    Format.VTK_LEGACY: read_vtk,
    Format.VTK_XML: read_vtk,
    Format.MNI_OBJ: read_mni_obj,
    Format.FREESURFER_SURFACE: read_surface,
    Format.FREESURFER_QUADS: read_quadrangles,
    Format.FREESURFER_ASCII: read_ascii_surface,
}
"""By the format of the file."""


def endings_of(readers: Readers[Contents]) -> tuple[str, ...]:
    """Return what names of files that these readers read usually end in."""
    return tuple(ending for ending, found in ENDINGS.items() if found in readers)


MESH_ENDINGS = (*endings_of(READERS), *(f"{ending}.gz" for ending in endings_of(READERS)))
"""What names of meshes usually end in; surfaces of FreeSurfer may end in anything."""


def load_mesh(
    mesh: MeshLike,
    *,
    merge: bool | float | None = None,
    clean: bool = False,
    hemisphere: str | None = None,
    largest_component: bool = False,
) -> TriangleMesh:
    """Read a triangle mesh from a file, or make one of a mesh of another library.

    Vertices keep the order and count of the file or object, unused ones included; only STL and
    glTF, which repeat vertices, are merged by position, with a message. Polygons and strips are
    split into triangles. glTF is read as it is shown at rest, with its morph weights and skins.
    Surfaces of FreeSurfer, such as ``lh.white``, keep the coordinates of the file: surface RAS, to
    which ``cras`` is not added, as in nibabel.

    Parameters
    ----------
    mesh : path or object
        A file: obj, off, ply, stl, glb, gltf, gii, vtk, vtp, vtu, surfaces of FreeSurfer or MNI
        objects; each may be compressed (.gz). Its first bytes decide the format, or else the ending
        of its name. Or a pair (vertices, faces), a ``trimesh.Trimesh``, PyVista ``PolyData`` or
        ``UnstructuredGrid``, a mesh of meshio, Open3D, PyMeshLab, vedo, LaPy or BrainSpace,
        nilearn's ``SurfaceImage`` or ``PolyMesh``, a nibabel GIFTI image, or a `TriangleMesh`,
        which is returned as it is.
    merge : bool or float, optional
        Make vertices one that are at most this distance apart, in the file's unit, as where a
        texture has a seam: the first of them stays where it is. A distance of an edge's length is
        refused. True takes 1e-6 of the diagonal of the bounding box, or less where edges are short.
    clean : bool
        Remove repeated faces, and sheets that hang on a surface of at least their area. Remove
        faces without area: join their ends if these are close, or else split their neighbours, so
        that no hole is left. What cannot be cleaned so is refused.
    hemisphere : {"L", "R"}, optional
        Of a surface with both hemispheres, keep one. L has the smaller x; if both are at one place,
        as spheres are, it is the first in the file, as Connectome Workbench and nilearn order them.
        A surface in one piece is kept as it is. Of objects of nilearn, the part.
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
    options = MeshKeywords(
        merge=merge, clean=clean, hemisphere=hemisphere, largest_component=largest_component
    )
    return as_mesh(mesh, **options)


def as_mesh(given: MeshLike, name: str = "mesh", **options: Unpack[MeshKeywords]) -> TriangleMesh:
    """Return what `load_mesh` does; in messages an object is called by the name."""
    if isinstance(given, TriangleMesh):
        if any(options.values()):
            raise ParameterError("options of a mesh apply where it is made, not to a TriangleMesh")
        return given
    is_file = isinstance(given, str | os.PathLike)
    name = one_line(given, _NAME_LENGTH_MAX) if is_file else name
    try:
        side = options.get("hemisphere")
        if is_file:
            found = read_contents(given, READERS, "mesh")
            named = found.side or named_side(given)
            if side and named and named != side:
                raise MeshError(
                    f"it is a {HEMISPHERES[named]} hemisphere, and the {HEMISPHERES[side]} one was "
                    "requested: leave out --hemisphere, or choose another file"
                )
            side = side or named
        else:
            found = _of_object(given, side)
            side = side or found.side
            if parts_of(given):
                options["hemisphere"] = None
        return TriangleMesh(
            found.vertices,
            found.faces,
            structure=STRUCTURES.get(side or ""),
            file_name=os.path.basename(given) if is_file else "",
            messages=found.messages,
            **options,
        )
    except MemoryError as error:
        raise MeshError(
            f"{name}: the mesh does not fit into memory: close other programs, or coarsen it"
        ) from error
    except MeshError as error:
        raise error.in_file(name) from error


def as_meshes(a: MeshLike, b: MeshLike) -> tuple[TriangleMesh, TriangleMesh]:
    """Return `as_mesh` of two surfaces, one mesh if they are the same object."""
    mesh = as_mesh(a, "a")
    return mesh, mesh if a is b else as_mesh(b, "b")


def _of_object(given: object, hemisphere: str | None) -> FileContents:
    try:
        return contents_of(given, hemisphere or "")
    except MemoryError:
        raise
    except Exception as error:  # the objects are not ours, and may raise anything
        raise MeshError(one_line(error, 400)) from error


def read_contents(
    path: str | os.PathLike[str], readers: Readers[Contents], wanted: str
) -> Contents:
    """Return the contents of a file, or raise a MeshError, whatever a reader raises on a bad file.

    Parameters
    ----------
    readers : mapping
        By the formats that can be read.
    wanted : str
        What the file is expected to hold, such as "mesh".
    """
    opened = None
    try:
        opened = open_file(path)
        if opened.format not in readers:
            known = ", ".join(endings_of(readers))
            more = " or a FreeSurfer surface" * (Format.FREESURFER_SURFACE in readers)
            raise MeshError(f"it is {opened.format}, not a {wanted}; expected {known}{more}")
        with step("reading", len(opened.data), f" {opened.format}"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return readers[opened.format](opened)
    except (MemoryError, MeshError):
        raise
    except FileNotFoundError as error:
        missing = f"a file that it names is missing: {one_line(error.filename)}"
        raise MeshError(missing if opened else "there is no such file") from error
    except IsADirectoryError as error:
        named = "a file that it names is a folder: correct the name"
        raise MeshError(named if opened else "this is a folder, not a file") from error
    except Exception as error:
        read_as = f" as {opened.format}" if opened else ""
        raise MeshError(f"cannot be read{read_as}: {one_line(error)}") from error

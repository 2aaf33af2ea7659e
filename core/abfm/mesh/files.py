"""Reading of meshes from files and from objects of other libraries."""

import os
import warnings
from collections.abc import Callable, Mapping
from typing import TypeVar, Unpack

from abfm.assets import asset_names, asset_path
from abfm.errors import MeshError, ParameterError, one_line
from abfm.mesh.objects import MeshLike, contents_of, parts_of
from abfm.mesh.options import MeshKeywords
from abfm.mesh.readers import brain
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
    file = vtk_contents(opened)
    return split_polygons(file.points, *file.polygons())


READERS: Readers[FileContents] = {
    Format.OBJ: read_obj,
    Format.OFF: read_off,
    Format.PLY: read_ply,
    Format.STL: read_stl,
    Format.GLB: read_gltf,
    Format.GLTF: read_gltf,
    Format.GIFTI: brain.read_gifti,
    Format.VTK_LEGACY: read_vtk,
    Format.VTK_XML: read_vtk,
    Format.MNI_OBJ: brain.read_mni_obj,
    Format.FREESURFER_SURFACE: brain.read_surface,
    Format.FREESURFER_QUADS: brain.read_quadrangles,
    Format.FREESURFER_ASCII: brain.read_ascii_surface,
}
"""The reader of each file format."""


def endings_of(readers: Readers[Contents]) -> tuple[str, ...]:
    return tuple(ending for ending, found in ENDINGS.items() if found in readers)


MESH_ENDINGS = (*endings_of(READERS), *(f"{ending}.gz" for ending in endings_of(READERS)))
"""Usual endings of names of mesh files; names of FreeSurfer surfaces may have any ending."""


def load_mesh(
    mesh: MeshLike,
    *,
    merge: bool | float | None = None,
    clean: bool = False,
    hemisphere: str | None = None,
    largest_component: bool = False,
) -> TriangleMesh:
    """Read a triangle mesh from a file, or convert a mesh of another library.

    Vertices have the order and count of the file or object, including those that no face uses. STL
    and glTF files repeat vertices; these are merged by position, with a message. Polygons and
    triangle strips are split into triangles. A glTF scene is read in its rest pose, with its morph
    weights and skins. FreeSurfer surfaces, such as ``lh.white``, have the coordinates of the file:
    surface RAS without ``cras``, as in nibabel.

    Parameters
    ----------
    mesh : path or object
        A file is obj, off, ply, stl, glb, gltf, gii, vtk, vtp, vtu, a FreeSurfer surface or an MNI
        object. It may be compressed (.gz). Its first bytes determine the format, or else the ending
        of its name. Accepted objects are:

        - a pair (vertices, faces)
        - a ``trimesh.Trimesh``
        - PyVista ``PolyData`` or ``UnstructuredGrid``
        - a mesh of meshio, Open3D, PyMeshLab, vedo, LaPy or BrainSpace
        - nilearn's ``SurfaceImage`` or ``PolyMesh``, or a nibabel GIFTI image
        - a `TriangleMesh`, which is returned unchanged
    merge : bool or float, optional
        Merge vertices that are at most this distance apart, in the unit of the file, for example at
        the seams of a texture. The first vertex of a group keeps its position. The distance must be
        smaller than every edge. True uses 1e-6 of the diagonal of the bounding box, or less if
        edges are short.
    clean : bool
        Remove repeated faces, and sheets: smaller parts joined to the surface only along edges with
        three faces. Remove faces without area: merge their ends if these are close, or else split
        their neighbours, so that no hole remains. A mesh that still has defects is refused.
    hemisphere : {"L", "R"}, optional
        Hemisphere to keep, of a surface with both. L has the smaller x. If both are at the same
        place, as spheres are, L is the first in the file, the order of Connectome Workbench and
        nilearn. A surface of one component is kept as it is. For nilearn objects, the argument
        chooses the part.
    largest_component : bool
        Whether to keep only the component with the largest area, if there are several.

    Notes
    -----
    Options apply in this order. `TriangleMesh.messages` reports every change with a count and an
    example. Arrays with one value for each vertex of the file remain usable: see
    `TriangleMesh.restrict`, and `TriangleMesh.on_file` for results.

    Raises
    ------
    MeshError
        One line that begins with the name of the file: it cannot be read, or its mesh cannot be
        used.
    """
    options = MeshKeywords(
        merge=merge, clean=clean, hemisphere=hemisphere, largest_component=largest_component
    )
    return as_mesh(mesh, **options)


def as_mesh(source: MeshLike, name: str = "mesh", **options: Unpack[MeshKeywords]) -> TriangleMesh:
    """Return the mesh of a file or object as `load_mesh` does; messages call an object ``name``."""
    if isinstance(source, TriangleMesh):
        if any(options.values()):
            raise ParameterError(
                "mesh options such as merge or clean cannot change a TriangleMesh. Use them when "
                "the mesh is loaded"
            )
        return source
    is_file = isinstance(source, str | os.PathLike)
    name = one_line(source, _NAME_LENGTH_MAX) if is_file else name
    try:
        side = options.get("hemisphere")
        if is_file:
            found = read_contents(source, READERS, "mesh")
            named = found.side or named_side(source)
            if side and named and named != side:
                raise MeshError(
                    f"the file has a {HEMISPHERES[named]} hemisphere, but the {HEMISPHERES[side]} "
                    "one was requested. Omit --hemisphere, or choose another file"
                )
            side = side or named
        else:
            found = _of_object(source, side)
            side = side or found.side
            if parts_of(source):
                options["hemisphere"] = None
        return TriangleMesh(
            found.vertices,
            found.faces,
            structure=STRUCTURES.get(side or ""),
            file_name=os.path.basename(source) if is_file else "",
            messages=found.messages,
            **options,
        )
    except MemoryError as error:
        raise MeshError(
            f"{name}: the mesh does not fit into memory. Close other programs, or coarsen the mesh"
        ) from error
    except MeshError as error:
        raise error.in_file(name) from error


def as_meshes(a: MeshLike, b: MeshLike) -> tuple[TriangleMesh, TriangleMesh]:
    """Return two surfaces as meshes, see `as_mesh`; the same mesh twice if ``a`` is ``b``."""
    mesh = as_mesh(a, "a")
    return mesh, mesh if a is b else as_mesh(b, "b")


def _of_object(source: object, hemisphere: str | None) -> FileContents:
    try:
        return contents_of(source, hemisphere or "")
    except MemoryError:
        raise
    except Exception as error:  # objects of other libraries may raise any error
        raise MeshError(one_line(error, 400)) from error


def _missing_file(path: str | os.PathLike[str]) -> str:
    """Return the message about a missing file, with the path of a bundled file of this name."""
    name = os.path.basename(path)
    if name not in asset_names():
        return "the file does not exist"
    return f"the file does not exist. A bundled file has this name; use {asset_path(name)}"


def read_contents(
    path: str | os.PathLike[str], readers: Readers[Contents], expected: str
) -> Contents:
    """Return the contents of a file; convert every error of a reader to a MeshError.

    ``readers`` has the reader of each supported format. Messages call the file ``expected``, such
    as "mesh".
    """
    opened = None
    try:
        opened = open_file(path)
        if opened.format not in readers:
            endings = ", ".join(endings_of(readers))
            more = " or a FreeSurfer surface" * (Format.FREESURFER_SURFACE in readers)
            raise MeshError(
                f"the file is {opened.format}, not a {expected}; expected {endings}{more}"
            )
        with step("reading", len(opened.data), f" {opened.format}"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return readers[opened.format](opened)
    except (MemoryError, MeshError):
        raise
    except FileNotFoundError as error:
        missing = f"the file refers to {one_line(error.filename)}, which does not exist"
        raise MeshError(missing if opened else _missing_file(path)) from error
    except IsADirectoryError as error:
        folder = "the file refers to a folder instead of a file. Correct the name"
        raise MeshError(folder if opened else "this is a folder, not a file") from error
    except Exception as error:
        read_as = f" as {opened.format}" if opened else ""
        raise MeshError(f"cannot be read{read_as}: {one_line(error)}") from error

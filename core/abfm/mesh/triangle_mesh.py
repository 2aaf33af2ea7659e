"""Triangle meshes that are checked once and immutable."""

from __future__ import annotations

import copy
import hashlib
import warnings
from collections.abc import Callable, Iterable
from functools import cached_property, wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, Concatenate, NoReturn, ParamSpec, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.display import Display
from abfm.errors import AbfmWarning, FunctionError, MeshError, one_line
from abfm.mesh.checks import check
from abfm.mesh.draft import FileNumbers
from abfm.mesh.face_sizes import twice_areas
from abfm.mesh.options import MeshKeywords, MeshOptions
from abfm.mesh.topology import connected, grouped, next_corner, pinched_vertices
from abfm.types import BoolArray, FloatArray, IntArray
from abfm.wording import counted
from abfm.workers.messages import sent_by_name

if TYPE_CHECKING:
    import trimesh

Result = TypeVar("Result")
Others = ParamSpec("Others")
Number = TypeVar("Number", bound=np.generic)

_COPY_ROUNDING = 1e-6  # rounding errors of writing and reading, as a fraction of the largest value
_NORMAL_SHARE_MIN = 0.3  # as a fraction of the value for a sphere, see `is_inside_out`


def per_mesh(
    build: Callable[Concatenate[TriangleMesh, Others], Result],
) -> Callable[Concatenate[TriangleMesh, Others], Result]:
    """Decorate a function ``build(mesh, ...)`` so that its results are cached with the mesh."""

    @wraps(build)
    def cached(mesh: TriangleMesh, /, *others: Others.args, **named: Others.kwargs) -> Result:
        key = (build.__module__, build.__qualname__, *others, *named.items())
        found: Result
        try:
            found = mesh.cache[key]
        except KeyError:  # if another thread builds it meanwhile, both return the same object
            found = mesh.cache.setdefault(key, build(mesh, *others, **named))
        return found

    return cached


@sent_by_name
class TriangleMesh(Display):
    """An oriented, connected, edge-manifold triangle mesh, with or without boundary.

    The following input is refused:

    - no vertices or no faces, wrong shapes or types, indices out of range
    - coordinates that are not finite, or so large or small that areas overflow or underflow
    - degenerate or duplicate faces, edges with more than two faces
    - one-sided surfaces, and surfaces of several components

    Two defects are repaired, with a message. Faces whose orientation disagrees are flipped: outward
    if the surface is closed, else to the orientation of most faces. Vertices that no face uses are
    dropped. Pinched vertices only cause a warning.

    Parameters
    ----------
    vertices, faces : (V, 3) array of float, (F, 3) array of int
        Positions of the vertices, and vertex indices of the corners of faces, counted from 0. Both
        arrays are copied.
    structure : str, optional
        Anatomical structure, as in GIFTI's ``AnatomicalStructurePrimary``, such as ``CortexLeft``.
        The structure is written to output files, and compared with that of values.
    file_name : str
        The name of the mesh file, for messages.
    messages : iterable of str
        Earlier changes of the input, put before the messages of the checks.
    numbers : FileNumbers, optional
        The ``vertex_ids``, ascending, the ``file_vertex_count`` and the ``copies``, if vertices
        were omitted or merged before.
    **options
        Changes before the checks: ``merge``, ``clean``, ``hemisphere`` and ``largest_component``,
        see :func:`abfm.load_mesh`.

    Attributes
    ----------
    vertex_ids, face_ids : (V,) and (F,) array of int
        The row of each vertex and face in the input or file, ascending.
    file_vertex_count : int
        Number of vertices of the input.
    copies : (n, 2) array of int
        Vertices of the input that were merged, ascending, and the vertices that they were merged
        into.
    numbered : two (n,) arrays of int
        The vertices of the input that the mesh has, ascending, including merged ones, and their
        rows in the mesh.
    file_name : str
        The name of the mesh file, or empty.
    messages : tuple of str
        Repairs and warnings, one line each.
    has_flipped_faces : bool
        Whether some faces were reversed so that all faces have the same orientation.
    edges, face_edges : (E, 2) and (F, 3) array of int
        Pairs of vertices of the edges, smaller index first, and the edge opposite each corner of a
        face.
    edge_slots : (E, 2) array of int
        The slots ``3 f + k`` of the corners opposite each edge, smaller first; the second is -1 on
        the boundary.
    corner_fans : (F, 3) array of int
        The vertex of each corner if the surface were cut at its pinched vertices.
    cache : dict
        Results cached by ``per_mesh``; the dictionary may be cleared at any time.

    Raises
    ------
    MeshError
        If the mesh has a defect. The message has the number of occurrences, an example numbered as
        in the input, and a remedy.
    """

    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    file_vertex_count: int
    copies: IntArray
    messages: tuple[str, ...]
    has_flipped_faces: bool
    edges: IntArray
    face_edges: IntArray
    cache: dict[Any, Any]
    edge_slots: IntArray
    corner_fans: IntArray
    structure: str | None
    file_name: str

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        structure: str | None = None,
        file_name: str = "",
        messages: Iterable[str] = (),
        numbers: FileNumbers | tuple[IntArray, int] | None = None,
        **options: Unpack[MeshKeywords],
    ) -> None:
        draft = check(vertices, faces, MeshOptions(**options), numbers)
        draft_state = vars(draft) | {"structure": structure, "file_name": file_name}
        self.__setstate__(draft_state | {"messages": (*messages, *draft.messages), "cache": {}})

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"a TriangleMesh is immutable. Create a new one instead of setting {name}"
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the cache, for copies and other processes."""
        return self.__dict__ | {"cache": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(
            {k: _frozen(v) if isinstance(v, np.ndarray) else v for k, v in state.items()}
        )

    def __repr__(self) -> str:
        return f"TriangleMesh({len(self.vertices)} vertices, {len(self.faces)} faces)"

    @property
    @per_mesh
    def opposite_slots(self) -> IntArray:
        """(F, 3) the slot of each corner's opposite edge in the adjacent face, or -1."""
        first, second = self.edge_slots.T
        opposite = np.full(self.faces.size, -1)
        opposite[first] = second
        inner = second >= 0
        opposite[second[inner]] = first[inner]
        return opposite.reshape(-1, 3)

    @property
    @per_mesh
    def digest(self) -> str:
        """Hash of the contents in hexadecimal digits, the same in every process."""
        found = hashlib.sha256(repr((self.file_vertex_count, self.messages)).encode())
        for name in ("vertices", "faces", "vertex_ids", "face_ids", "copies"):
            array = np.ascontiguousarray(getattr(self, name))
            found.update(f"{name} {array.dtype.str} {array.shape}".encode())
            found.update(array.data)
        return found.hexdigest()

    @property
    def message_name(self) -> str:
        """Name in messages between processes; equal only for meshes with the same attributes."""
        return f"{self.digest} {self.structure} {self.file_name}"

    @cached_property
    def length_scale(self) -> float:
        """Square root of the total area, the unit of length of the solver."""
        return float(np.sqrt(0.5 * twice_areas(self.vertices, self.faces).sum()))

    @per_mesh
    def normalized(self) -> TriangleMesh:
        """Return the same mesh scaled to unit area; it is cached."""
        scaled, vertices = copy.copy(self), _frozen(self.vertices / self.length_scale)
        scaled.__dict__.update(vertices=vertices, length_scale=1.0)
        return scaled

    @cached_property
    def edge_faces(self) -> IntArray:
        """(E, 2) the faces of each edge, smaller index first; the second is -1 on the boundary."""
        return _frozen(self.edge_slots // 3)

    @cached_property
    def is_boundary_edge(self) -> BoolArray:
        """(E,) whether each edge has only one face."""
        return _frozen(self.edge_slots[:, 1] < 0)

    @cached_property
    def is_boundary_vertex(self) -> BoolArray:
        """(V,) whether each vertex lies on the boundary."""
        mask = np.zeros(len(self.vertices), dtype=bool)
        mask[self.edges[self.is_boundary_edge]] = True
        return _frozen(mask)

    @cached_property
    def is_pinched_vertex(self) -> BoolArray:
        """(V,) whether parts of the surface without a shared edge touch at each vertex."""
        return _frozen(pinched_vertices(self.faces, self.corner_fans, len(self.vertices)))

    @property
    def is_closed(self) -> bool:
        """Whether the surface has no boundary."""
        return not self.is_boundary_edge.any()

    @cached_property
    def is_inside_out(self) -> bool:
        """Whether the surface is closed, or nearly, and its normals point inward.

        On average, the normals of such a surface point to its middle. Flat surfaces and saddles
        have no inner side. Therefore the threshold increases with the length of the mean normal,
        which is large if most normals have the same direction.
        """
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        normals, middles = np.cross(b - a, c - a), (a + b + c) / 3
        sizes = np.linalg.norm(normals, axis=1)
        outward = middles - sizes @ middles / sizes.sum()
        mean_normal = float(np.linalg.norm(normals.sum(axis=0)) / sizes.sum())
        sphere = float(sizes @ np.linalg.norm(outward, axis=1))
        threshold = _NORMAL_SHARE_MIN * mean_normal * sphere
        return float(np.einsum("fx,fx->", normals, outward)) < -threshold

    @property
    def euler_characteristic(self) -> int:
        """The Euler characteristic, V - E + F."""
        return len(self.vertices) - len(self.edges) + len(self.faces)

    @cached_property
    def parts(self) -> IntArray:
        """(F,) the part of each face; faces of a part are connected by edges.

        Different parts touch only at pinched vertices.
        """
        return _frozen(connected(len(self.faces), self.edge_faces[~self.is_boundary_edge]))

    @cached_property
    def boundary_loops(self) -> tuple[IntArray, ...]:
        """The vertices of each closed loop of the boundary.

        Boundary loops that touch at a pinched vertex are separate.
        """
        start = next_corner(self.edge_slots[self.is_boundary_edge, 0])
        ends = self.corner_fans.ravel()[np.stack([start, next_corner(start)], axis=1)]
        loops = connected(int(self.corner_fans.max()) + 1, ends)[ends[:, 0]]
        return tuple(map(_frozen, grouped(self.faces.ravel()[start], loops)))

    @cached_property
    def genus(self) -> int:
        """The number of handles: ``V - E + F = 2 - 2 genus - loops``.

        Before counting, the surface is cut at its pinched vertices.
        """
        characteristic = self.corner_fans.max() + 1 - len(self.edges) + len(self.faces)
        return int(2 * (self.parts.max() + 1) - len(self.boundary_loops) - characteristic) // 2

    @property
    @per_mesh
    def numbered(self) -> tuple[IntArray, IntArray]:
        if not len(self.copies):
            return self.vertex_ids, np.arange(len(self.vertices))
        rows = np.searchsorted(self.vertex_ids, self.copies[:, 1])
        numbers = np.concatenate([self.vertex_ids, self.copies[:, 0]])
        order = np.argsort(numbers)
        return numbers[order], np.concatenate([np.arange(len(self.vertices)), rows])[order]

    def local_vertices(self, numbers: NDArray[Any]) -> IntArray:
        """Convert vertex numbers of the file to rows of the mesh, in the same shape.

        The row is -1 for vertices that the mesh does not have.
        """
        file_numbers, rows = self.numbered
        place = np.searchsorted(file_numbers, numbers).clip(max=len(file_numbers) - 1)
        return np.where(file_numbers[place] == numbers, rows[place], -1)

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return a ``trimesh.Trimesh`` with the vertices and faces in this order."""
        import trimesh  # imported here as it loads many modules

        return trimesh.Trimesh(self.vertices.copy(), self.faces.copy(), process=False)

    def to_pyvista(self) -> Any:
        """Return PyVista ``PolyData`` with the vertices and faces in this order.

        Raises
        ------
        MeshError
            If PyVista is missing.
        """
        try:
            pyvista = import_module("pyvista")
        except ImportError as error:
            raise MeshError(
                f"PyVista cannot be imported ({one_line(error)}). Install it with: "
                "pip install pyvista"
            ) from error
        return pyvista.PolyData.from_regular_faces(self.vertices.copy(), self.faces)

    def local_vertex(self, index: int) -> int:
        """Return the row of the vertex with this number in the file, or raise a FunctionError."""
        if not 0 <= index < self.file_vertex_count:
            raise FunctionError(
                f"there is no vertex {index}: the mesh has {self.file_vertex_count} vertices, "
                f"numbered 0 to {self.file_vertex_count - 1}"
            )
        row = int(self.local_vertices(np.array(index)))
        if row < 0:
            raise FunctionError(
                f"vertex {index} was dropped because no remaining face uses it. Choose another one"
            )
        return row

    def restrict(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return the values (V, ...) of the vertices of the mesh.

        ``values`` has one row for each vertex of the file, (file_vertex_count, ...), or of the
        mesh, (V, ...). A vertex that others were merged into keeps its own value, as in ParaView.
        An AbfmWarning reports how many merged vertices have another value.

        Raises
        ------
        FunctionError
            If the number of rows is different.
        """
        if len(values) == self.file_vertex_count:
            if len(self.copies):
                self._warn_of_differences(values)
            return values[self.vertex_ids]
        if len(values) == len(self.vertices):
            return values
        expected = f"{self.file_vertex_count} vertices"
        if len(self.vertices) != self.file_vertex_count:
            expected += f" ({len(self.vertices)} of them kept)"
        raise FunctionError(
            f"there are {counted(len(values), 'value')}, but the mesh has {expected}. Use one "
            "value for each vertex"
        )

    def on_file(self, values: NDArray[Any], missing: float = np.nan) -> NDArray[Any]:
        """Expand values (V, ...) to one row for each vertex of the file; the inverse of `restrict`.

        Vertices that no face uses have the value ``missing``. Merged vertices have the value of the
        vertex that they were merged into.
        """
        if len(values) == self.file_vertex_count:
            return values
        shape = (self.file_vertex_count, *values.shape[1:])
        expanded = np.full(shape, missing, np.result_type(values.dtype, missing))
        numbers, rows = self.numbered
        expanded[numbers] = values[rows]
        return expanded

    def _warn_of_differences(self, values: NDArray[Any]) -> None:
        copies, firsts = (values[part].reshape(len(self.copies), -1) for part in self.copies.T)
        # two NaN count as equal
        differs = (copies != firsts) & ((copies == copies) | (firsts == firsts))
        if values.dtype.kind == "f" and differs.any():
            differs &= ~(np.abs(copies - firsts) <= _COPY_ROUNDING * np.nanmax(np.abs(values)))
        rows = np.flatnonzero(differs.any(axis=1))
        if len(rows):
            copy, first = self.copies[rows[0]]
            warnings.warn(
                f"{len(rows)} of {len(copies)} merged vertices had another value than the vertex "
                f"that they were merged into (for example vertex {copy}, merged into vertex "
                f"{first}). The values of merged vertices are ignored",
                AbfmWarning,
                stacklevel=3,
            )


def _frozen(array: NDArray[Number]) -> NDArray[Number]:
    array.flags.writeable = False
    return array

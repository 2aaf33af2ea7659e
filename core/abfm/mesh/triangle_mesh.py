"""A triangle mesh that has been checked once and never changes."""

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
from abfm.workers.messages import sent_by_name

if TYPE_CHECKING:
    import trimesh

Result = TypeVar("Result")
Others = ParamSpec("Others")
Number = TypeVar("Number", bound=np.generic)

_COPY_ROUNDING = 1e-6  # of the largest value: a difference that writing and reading may make
_NORMAL_SHARE_MIN = 0.3  # of what the normals of a sphere come to


def per_mesh(
    build: Callable[Concatenate[TriangleMesh, Others], Result],
) -> Callable[Concatenate[TriangleMesh, Others], Result]:
    """Decorate ``build(mesh, ...)``, whose results are to be made once and kept with the mesh."""

    @wraps(build)
    def cached(mesh: TriangleMesh, /, *others: Others.args, **named: Others.kwargs) -> Result:
        key = (build.__module__, build.__qualname__, *others, *named.items())
        found: Result
        try:
            found = mesh.cache[key]
        except KeyError:  # another thread may build it meanwhile: there is only one
            found = mesh.cache.setdefault(key, build(mesh, *others, **named))
        return found

    return cached


@sent_by_name
class TriangleMesh(Display):
    """An oriented, connected, edge-manifold triangle mesh, with or without boundary.

    Refused: no vertices or faces, wrong shapes or types, coordinates that are not finite or
    overflow, indices out of range, degenerate or duplicate faces, edges with more than two faces,
    one-sided surfaces, several components. Repaired, with a message: faces that disagree on a side
    are turned over (outward where the surface is closed, otherwise to the side that most faces
    have), vertices that no face uses are dropped. Pinched vertices are only reported.

    Parameters
    ----------
    vertices, faces : (V, 3) array of float, (F, 3) array of int
        Corners of triangles count vertices from 0. Copied.
    structure : str, optional
        What it is a surface of, as GIFTI's ``AnatomicalStructurePrimary`` has it, such as
        ``CortexLeft``. It is written with outputs and compared with that of values.
    file_name : str
        The name of its file, for messages.
    messages : iterable of str
        What was already done to the input, put before the messages of the checks.
    numbers : FileNumbers, optional
        The vertex_ids, ascending, the file_vertex_count and the copies, if vertices were left out
        or merged already.
    **options
        What to change first: ``merge``, ``clean``, ``hemisphere`` and ``largest_component``, see
        :func:`abfm.load_mesh`.

    Attributes
    ----------
    vertex_ids, face_ids : (V,) and (F,) array of int
        Rows of the input, or of the file, that vertices and faces came from; ascending.
    file_vertex_count : int
        Number of vertices of the input.
    copies : (n, 2) array of int
        Vertices of the input that were merged into another one, ascending, and that one.
    numbered : tuple of (n,) array of int, twice
        The vertices of the input that the mesh has, ascending, merged ones included, and their
        rows.
    file_name : str
        The name of its file, or empty.
    messages : tuple of str
        What was repaired or is worth a warning; one line each.
    edges, face_edges : (E, 2) and (F, 3) array of int
        Vertex pairs, smaller index first, and the edge opposite each corner.
    edge_slots : (E, 2) array of int
        The slots ``3 f + k`` of the corners opposite each edge, smaller first; -1 is no second one.
    corner_fans : (F, 3) array of int
        The vertex of each corner if pinched vertices were cut apart.
    cache : dict
        What :func:`per_mesh` keeps; it may be cleared at any time.

    Raises
    ------
    MeshError
        Naming the defect, how often it occurs, an example as the input counts, and what to do.
    """

    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    file_vertex_count: int
    copies: IntArray
    messages: tuple[str, ...]
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
            f"a TriangleMesh does not change: make a new one instead of setting {name}"
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy, or the mesh in another process, has: nothing that is kept here."""
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
        """The slot ``3 f + k`` of each corner's opposite edge in the other face, or -1, (F, 3)."""
        first, second = self.edge_slots.T
        opposite = np.full(self.faces.size, -1)
        opposite[first] = second
        inner = second >= 0
        opposite[second[inner]] = first[inner]
        return opposite.reshape(-1, 3)

    @property
    @per_mesh
    def digest(self) -> str:
        """Name of the mesh by its content, in hexadecimal digits: the same in every process."""
        found = hashlib.sha256(repr((self.file_vertex_count, self.messages)).encode())
        for name in ("vertices", "faces", "vertex_ids", "face_ids", "copies"):
            array = np.ascontiguousarray(getattr(self, name))
            found.update(f"{name} {array.dtype.str} {array.shape}".encode())
            found.update(array.data)
        return found.hexdigest()

    @cached_property
    def length_scale(self) -> float:
        """Square root of the total area: the length unit of the solver."""
        return float(np.sqrt(0.5 * twice_areas(self.vertices, self.faces).sum()))

    @per_mesh
    def normalized(self) -> TriangleMesh:
        """Return the same mesh scaled to unit area (made once)."""
        scaled, vertices = copy.copy(self), _frozen(self.vertices / self.length_scale)
        scaled.__dict__.update(vertices=vertices, length_scale=1.0)
        return scaled

    @cached_property
    def edge_faces(self) -> IntArray:
        """(E, 2) faces of each edge, smaller index first; the second is -1 on the boundary."""
        return _frozen(self.edge_slots // 3)

    @cached_property
    def is_boundary_edge(self) -> BoolArray:
        """(E,) True where an edge has one face."""
        return _frozen(self.edge_slots[:, 1] < 0)

    @cached_property
    def is_boundary_vertex(self) -> BoolArray:
        """(V,) True where a vertex lies on the boundary."""
        mask = np.zeros(len(self.vertices), dtype=bool)
        mask[self.edges[self.is_boundary_edge]] = True
        return _frozen(mask)

    @cached_property
    def is_pinched_vertex(self) -> BoolArray:
        """(V,) True where parts of the surface that share no edge touch."""
        return _frozen(pinched_vertices(self.faces, self.corner_fans, len(self.vertices)))

    @property
    def is_closed(self) -> bool:
        return not self.is_boundary_edge.any()

    @cached_property
    def is_inside_out(self) -> bool:
        """Whether it encloses space, all of it or nearly, and its faces look inward.

        Normals then point to the middle, on the whole; the more clearly, the more they agree on a
        direction, as a dish's do: what is flat or shaped like a saddle has no inner side.
        """
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        normals, middles = np.cross(b - a, c - a), (a + b + c) / 3
        sizes = np.linalg.norm(normals, axis=1)
        outward = middles - sizes @ middles / sizes.sum()
        agree = float(np.linalg.norm(normals.sum(axis=0)) / sizes.sum())
        clearly = _NORMAL_SHARE_MIN * agree * float(sizes @ np.linalg.norm(outward, axis=1))
        return float(np.einsum("fx,fx->", normals, outward)) < -clearly

    @property
    def euler_characteristic(self) -> int:
        """V - E + F."""
        return len(self.vertices) - len(self.edges) + len(self.faces)

    @cached_property
    def parts(self) -> IntArray:
        """(F,) part of each face: faces joined by edges; parts touch at pinched vertices alone."""
        return _frozen(connected(len(self.faces), self.edge_faces[~self.is_boundary_edge]))

    @cached_property
    def boundary_loops(self) -> tuple[IntArray, ...]:
        """Vertices of each closed loop of the boundary; two that touch at a pinched vertex."""
        start = next_corner(self.edge_slots[self.is_boundary_edge, 0])
        ends = self.corner_fans.ravel()[np.stack([start, next_corner(start)], axis=1)]
        loops = connected(int(self.corner_fans.max()) + 1, ends)[ends[:, 0]]
        return tuple(map(_frozen, grouped(self.faces.ravel()[start], loops)))

    @cached_property
    def genus(self) -> int:
        """Handles: ``V - E + F = 2 - 2 genus - loops`` with pinched vertices cut apart."""
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
        """Return the rows of vertices as the file counts them, in the same shape; -1 for others."""
        known, rows = self.numbered
        place = np.searchsorted(known, numbers).clip(max=len(known) - 1)
        return np.where(known[place] == numbers, rows[place], -1)

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return a ``trimesh.Trimesh`` with the vertices and faces in this order."""
        import trimesh  # with what it loads

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
                f"PyVista cannot be imported ({one_line(error)}); install it with: "
                "pip install pyvista"
            ) from error
        return pyvista.PolyData.from_regular_faces(self.vertices.copy(), self.faces)

    def local_vertex(self, index: int) -> int:
        """Return the row of the vertex that the file calls ``index``, or raise a FunctionError."""
        if not 0 <= index < self.file_vertex_count:
            raise FunctionError(
                f"there is no vertex {index}: the mesh has {self.file_vertex_count} vertices, "
                f"numbered 0 to {self.file_vertex_count - 1}"
            )
        row = int(self.local_vertices(np.array(index)))
        if row < 0:
            raise FunctionError(
                f"vertex {index} was dropped, as no kept face uses it: choose another"
            )
        return row

    def restrict(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return the kept rows (V, ...) of (file_vertex_count, ...) or (V, ...) values.

        Of vertices that were merged the value of the first one is taken, as ParaView does; a
        AbfmWarning reports how many others differ from it.
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
            f"{len(values)} values were given for a mesh of {expected}: give one per vertex"
        )

    def on_file(self, values: NDArray[Any], missing: float = np.nan) -> NDArray[Any]:
        """Return values (V, ...) as rows of the mesh's file, (file_vertex_count, ...), the inverse
        of `restrict`; vertices that no face uses get the value ``missing``, and those that were
        merged the value of the vertex that they became.
        """
        if len(values) == self.file_vertex_count:
            return values
        shape = (self.file_vertex_count, *values.shape[1:])
        whole = np.full(shape, missing, np.result_type(values.dtype, missing))
        numbers, rows = self.numbered
        whole[numbers] = values[rows]
        return whole

    def _warn_of_differences(self, values: NDArray[Any]) -> None:
        copies, kept = (values[part].reshape(len(self.copies), -1) for part in self.copies.T)
        differs = (copies != kept) & ((copies == copies) | (kept == kept))  # both NaN are the same
        if values.dtype.kind == "f" and differs.any():
            differs &= ~(np.abs(copies - kept) <= _COPY_ROUNDING * np.nanmax(np.abs(values)))
        rows = np.flatnonzero(differs.any(axis=1))
        if len(rows):
            copy, first = self.copies[rows[0]]
            warnings.warn(
                f"{len(rows)} of {len(copies)} merged vertices have another value than the vertex "
                f"that they were merged into, whose value is taken (for example vertex {copy} than "
                f"vertex {first})",
                AbfmWarning,
                stacklevel=3,
            )


def _frozen(array: NDArray[Number]) -> NDArray[Number]:
    array.flags.writeable = False
    return array

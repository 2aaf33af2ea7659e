"""Where two surfaces correspond, and what goes from one to the other by it."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from abfm.calculus.channels import at_vertices
from abfm.calculus.operators import edge_lengths, face_areas, vertex_areas
from abfm.display import Display
from abfm.errors import AbfmError, FunctionError, ParameterError, brief
from abfm.functions import as_values
from abfm.io import results
from abfm.maps.distortion import Distortion, flipped_triangles
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import MapAccuracy, RoundTrip, map_accuracy, round_trip
from abfm.maps.spherical import SphereLayout, through_sphere
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.mesh import TriangleMesh
from abfm.types import File, FloatArray, IntArray

TransferMethod: TypeAlias = Literal["point", "area"]
_COVERAGE_FACES_MAX = 20_000  # faces that are asked for the coverage
_WEIGHT_MIN = 1e-12  # of a weight that carries
_CANDIDATES = "candidates", "candidate_costs"  # in files
_ROUNDING = 1e-9  # sqrt(area) between places that are one


class Candidate(NamedTuple):
    """An initial map that was tried: its word, see `abfm.register`, and its cost, NaN if it was
    compared with no other one.
    """

    name: str
    cost: float


class Correspondence(Display):
    """Where on surface A each vertex of surface B lies, and back.

    Parameters
    ----------
    points : PointMap
        From B to A.
    back : PointMap, optional
        From A to B; else found by the points of B whose images are closest (`PointMap.inverse`).

    Attributes
    ----------
    candidates : tuple of Candidate
        If the map was searched: what was tried, the chosen one first, then by cost.

    Examples
    --------
    >>> import abfm
    >>> from abfm.assets import asset_path
    >>> a, b = (abfm.load_mesh(asset_path(f"human_{pose}.off")) for pose in "AB")
    >>> same = abfm.Correspondence(abfm.PointMap.of_vertices(b, a))
    >>> same.transfer(a.vertices).shape == b.vertices.shape
    True
    """

    candidates: tuple[Candidate, ...] = ()

    def __init__(self, points: PointMap, back: PointMap | None = None) -> None:
        if back is not None:
            pairs = (back.domain, points.codomain), (back.codomain, points.domain)
            if any(len(one.faces) != len(other.faces) for one, other in pairs):
                raise AbfmError("the way back is between other surfaces than the way there")
        self._there, self._back = points, back

    @classmethod
    def through_sphere(
        cls, a: TriangleMesh, b: TriangleMesh, sphere_a: ArrayLike, sphere_b: ArrayLike
    ) -> Correspondence:
        """Return the correspondence of points in the same direction on a sphere on which both
        surfaces are laid out, by unit vectors (V_A, 3) and (V_B, 3): exact inside faces, and back.
        """
        return _ThroughSphere(SphereLayout(a, sphere_a), SphereLayout(b, sphere_b))

    @classmethod
    def of_same_faces(cls, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        """Return that of two meshes with the same faces: each point to the one of the same face
        and weights.
        """
        if not np.array_equal(a.faces, b.faces):
            raise AbfmError(
                f"the surfaces have {len(a.faces)} and {len(b.faces)} faces, not the same ones; "
                "equal connectivity is needed for a map by vertex numbers"
            )
        return cls(_by_number(b, a), _by_number(a, b))

    @property
    def points(self) -> PointMap:
        """Where on A each vertex of B lies."""
        return self._there

    @property
    def a(self) -> TriangleMesh:
        return self.points.codomain

    @property
    def b(self) -> TriangleMesh:
        return self.points.domain

    @cached_property
    def back(self) -> PointMap:
        """Where on B each vertex of A lies."""
        return self.points.inverse() if self._back is None else self._back

    def transfer(self, h: ArrayLike, by: TransferMethod = "point") -> FloatArray:
        """Carry a function of A, (V_A,) or (V_A, C), to B, (V_B,) or (V_B, C).

        ``by="point"`` takes at each vertex of B the value where it lies on A, linear inside faces;
        ``by="area"`` means over all vertices of A around it, see `to_matrix`. What is not finite
        makes what is transferred of it so.
        """
        given = as_values(self.a, h, "h")
        if given.ndim not in (1, 2):
            raise FunctionError(f"h has shape {given.shape}; expected (V_A,) or (V_A, C)")
        transferred: FloatArray = _without_zeros(self.to_matrix(by)) @ self.a.restrict(given)
        return transferred

    def transfer_labels(self, labels: ArrayLike, by: TransferMethod = "point") -> IntArray:
        """Carry labels of A, whole numbers (V_A,), to B, (V_B,): at each vertex the label that has
        most weight there, the smallest of several; never a mixture.
        """
        given = self.a.restrict(_whole(self.a, labels))
        known, numbers = np.unique(given, return_inverse=True)
        weights = self.to_matrix(by)
        rows = np.arange(len(numbers))
        one_each = sparse.csr_array(
            (np.ones(len(rows)), (rows, numbers)), shape=(len(rows), len(known))
        )
        shares = sparse.csr_array(weights @ one_each)
        return np.asarray(known[np.asarray(shares.argmax(axis=1)).ravel()])

    def transfer_points(self, points: SurfacePoints | ArrayLike) -> SurfacePoints:
        """Return where points of A, or vertices (P,) by number, lie on B."""
        given = points if isinstance(points, SurfacePoints) else vertex_points(self.a, points)
        if len(given.mesh.faces) != len(self.a.faces):
            raise AbfmError("the points are of another surface than A")
        return self.back.at(given)

    def inverse(self) -> Correspondence:
        """Return the correspondence from B to A."""
        return Correspondence(self.back, self.points)

    def on_surfaces(self, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        """Return the same one between surfaces of the same faces that are elsewhere in space, such
        as cortices of which it took the spheres: by the same faces and weights.
        """
        for name, mesh, own in (("A", a, self.a), ("B", b, self.b)):
            if not np.array_equal(mesh.faces, own.faces):
                raise ParameterError(f"the map is of another surface {name} than the one given")
        if _same_places(a, self.a) and _same_places(b, self.b):
            return self
        return self._on_surfaces(a, b).with_candidates(self.candidates)

    def with_candidates(self, candidates: tuple[Candidate, ...]) -> Correspondence:
        """Return this map as the one that was chosen of several."""
        found = object.__new__(type(self))  # copies otherwise go through files' arrays
        found.__dict__.update(self.__dict__)
        found.candidates = candidates
        return found

    def _on_surfaces(self, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        return Correspondence(_placed(self.points, b, a), _placed(self.back, a, b))

    def compose(self, other: Correspondence) -> Correspondence:
        """Return the correspondence from A to C, with another one from B to C."""
        return Correspondence(
            other.points.followed_by(self.points), self.back.followed_by(other.back)
        )

    def to_matrix(self, by: TransferMethod = "point") -> sparse.csr_array:
        """Return the matrix (V_B, V_A) of `carry`; rows sum to 1.

        By points, rows have at most three entries. By area, each vertex of A gives its area to the
        vertices of B around it, so that the mean over A is kept, by the areas that the rows were
        given; where B is finer than A it is the interpolation by points, weighed alike (adaptive
        barycentric area resampling, as in Connectome Workbench).
        """
        if by == "point":
            return self.points.to_matrix()
        if by != "area":
            raise ParameterError(f"by is {brief(by)}; expected 'point' or 'area'")
        shares = self.area_shares()
        return sparse.csr_array(sparse.diags_array(1 / shares.sum(axis=1)) @ shares)

    def area_shares(self) -> sparse.csr_array:
        """Return what of the area of each vertex of A goes to each of B, (V_B, V_A): columns sum to
        the areas of A, except for vertices that nothing of B is near to.
        """
        forward = _without_zeros(self.points.to_matrix())
        reverse = _without_zeros(sparse.csr_array(self.back.to_matrix().T))
        # B's vertices that get from A all that they would be interpolated from
        common = forward.astype(bool).multiply(reverse.astype(bool))
        whole = np.asarray(common.sum(axis=1)).ravel() == np.diff(forward.indptr)
        keep, drop = sparse.diags_array(whole.astype(float)), sparse.diags_array(1.0 - whole)
        areas_b = sparse.diags_array(vertex_areas(self.b))
        chosen = sparse.csr_array(areas_b @ (keep @ reverse + drop @ forward))
        given = np.asarray(chosen.sum(axis=0)).ravel()
        factors = np.divide(vertex_areas(self.a), given, out=np.zeros_like(given), where=given > 0)
        return sparse.csr_array(chosen @ sparse.diags_array(factors))

    def to_vertices(self) -> IntArray:
        """Return the nearest vertex of A for each vertex of B, (V_B,)."""
        return self.points.nearest_vertices()

    def distortion(self) -> Distortion:
        """Measure what the map from B to A does to each face of B, with both surfaces scaled to
        unit area: see `PointMap.distortion`. Of a map that turns the surface over as a whole, such
        as between left and right, faces that do not are flipped.
        """
        return self._distortion

    @cached_property
    def _distortion(self) -> Distortion:
        points = self.points.onto_mirror() if self.is_mirrored else self.points
        return points.distortion().scaled(self.b.length_scale / self.a.length_scale)

    @cached_property
    def is_mirrored(self) -> bool:
        """Whether most of B, by area, lies on A with its other side up."""
        found = PointMap(self.b, self.a, self.points.faces, self.points.barycentric).distortion()
        return bool(found.weights[found.flipped].sum() > found.weights.sum() / 2)

    def flipped_by_vertices(self) -> int:
        """Return how many faces of A are flipped where its vertices alone are moved to B, as files
        of surfaces hold a map, such as a sphere.reg: their faces stay straight between vertices.
        """
        flipped = int(flipped_triangles(self.b, self.back.positions[self.a.faces]).sum())
        return len(self.a.faces) - flipped if self.is_mirrored else flipped

    def coverage(self) -> float:
        """Return the share of A's area, 0 to 1, that B is mapped onto: of the faces whose middle,
        taken to B and back to A, comes back no farther than the face is long. On large meshes
        20,000 faces, evenly chosen, stand for all.
        """
        count = len(self.a.faces)
        asked = np.linspace(0, count - 1, min(count, _COVERAGE_FACES_MAX)).astype(np.int64)
        lengths = edge_lengths(self.a)[self.a.face_edges[asked]].max(axis=1)
        middles = SurfacePoints(self.a, asked, np.full((len(asked), 3), 1 / 3))
        returned = self.points.at(self.back.at(middles))
        reached = returned.distances_from(middles.positions) <= lengths
        areas = face_areas(self.a)[asked]
        return float(areas[reached].sum() / areas.sum())

    def round_trip(self) -> RoundTrip:
        """Measure how far vertices of B come back from where they were, in edges."""
        return round_trip(self.points, self.back.at)

    def accuracy(self, truth: ArrayLike | None = None, most: int = 1000) -> MapAccuracy:
        """Measure geodesic errors against the true vertex of A for each of B, (V_B,), by default
        the one with its number, see `abfm.maps.map_accuracy`.
        """
        return map_accuracy(self.points, truth, most)

    def arrays(self) -> dict[str, Any]:
        """Return what files hold: B's mesh, A's under ``a_``, and the points both ways."""
        meshes = results.mesh_arrays(self.b) | {
            f"a_{name}": array for name, array in results.mesh_arrays(self.a).items()
        }
        return meshes | self._points()

    def _points(self) -> dict[str, Any]:
        named = {
            "candidates": np.array([each.name for each in self.candidates]),
            "candidate_costs": np.array([each.cost for each in self.candidates]),
        }
        return {
            **(named if self.candidates else {}),
            "image_faces": self.points.faces,
            "image_barycentric": self.points.barycentric,
            "back_faces": self.back.faces,
            "back_barycentric": self.back.barycentric,
        }

    def save(self, path: File) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError."""
        results.save_arrays(path, self.arrays(), results.CORRESPONDENCE)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let other processes have it by its points, as files do."""
        return _between, (self.a, self.b, self._points())

    def __repr__(self) -> str:
        return f"{type(self).__name__}(a={self.a!r}, b={self.b!r})"


class _ThroughSphere(Correspondence):
    """A correspondence by layouts of both surfaces on one sphere, which files keep."""

    def __init__(self, a: SphereLayout, b: SphereLayout) -> None:
        super().__init__(through_sphere(b, a), through_sphere(a, b))
        self._layouts = a, b

    def _points(self) -> dict[str, Any]:
        a, b = self._layouts
        return super()._points() | {"a_sphere": a.directions, "sphere": b.directions}

    def inverse(self) -> Correspondence:
        return _ThroughSphere(*self._layouts[::-1])

    def _on_surfaces(self, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        pairs = zip((a, b), self._layouts, strict=True)
        return _ThroughSphere(*(SphereLayout(mesh, own.directions) for mesh, own in pairs))


def correspondence_of(arrays: results.Arrays) -> Correspondence:
    """Return that of `Correspondence.arrays`; an AbfmError or a ValueError if they do not fit."""
    return _between(results.mesh_of(arrays, "a_"), results.mesh_of(arrays), arrays)


def load_correspondence(path: File) -> Correspondence:
    """Read a file of `Correspondence.save`; ResultError if it is missing, damaged, or none."""
    return results.loaded(path, results.CORRESPONDENCE, correspondence_of)


def _between(a: TriangleMesh, b: TriangleMesh, arrays: results.Arrays) -> Correspondence:
    names, costs = (arrays[key].tolist() if key in arrays else [] for key in _CANDIDATES)
    candidates = tuple(Candidate(*each) for each in zip(names, costs, strict=True))
    return _of_points(a, b, arrays).with_candidates(candidates)


def _of_points(a: TriangleMesh, b: TriangleMesh, arrays: results.Arrays) -> Correspondence:
    there = PointMap(b, a, arrays["image_faces"], arrays["image_barycentric"])
    back = PointMap(a, b, arrays["back_faces"], arrays["back_barycentric"])
    if "sphere" in arrays and "a_sphere" in arrays:
        return Correspondence.through_sphere(a, b, arrays["a_sphere"], arrays["sphere"])
    if np.array_equal(a.faces, b.faces) and _is_by_number(there) and _is_by_number(back):
        return Correspondence.of_same_faces(a, b)
    nearest = there.inverse()
    if np.allclose(nearest.positions, back.positions, rtol=0, atol=_ROUNDING * b.length_scale):
        back = PointMap(a, b, back.faces, back.barycentric, interior_map=nearest.interior_map)
    return Correspondence(there, back)


def _by_number(domain: TriangleMesh, codomain: TriangleMesh) -> PointMap:
    def interior_map(points: SurfacePoints) -> SurfacePoints:
        return SurfacePoints(codomain, points.faces, points.barycentric)

    return PointMap.of_points(domain, vertex_points(codomain), interior_map)


def _is_by_number(points: PointMap) -> bool:
    expected = vertex_points(points.codomain)
    same = np.array_equal(points.faces, expected.faces)
    return same and np.array_equal(points.barycentric, expected.barycentric)


def _same_places(one: TriangleMesh, other: TriangleMesh) -> bool:
    return one is other or np.array_equal(one.vertices, other.vertices)


def _placed(points: PointMap, domain: TriangleMesh, codomain: TriangleMesh) -> PointMap:
    """Return the same map between surfaces of the same faces."""
    own = points.interior_map

    def interior_map(given: SurfacePoints) -> SurfacePoints:
        assert own is not None
        found = own(SurfacePoints(points.domain, given.faces, given.barycentric))
        return SurfacePoints(codomain, found.faces, found.barycentric)

    placed = SurfacePoints(codomain, points.faces, points.barycentric)
    return PointMap.of_points(domain, placed, None if own is None else interior_map)


def _without_zeros(matrix: sparse.csr_array) -> sparse.csr_array:
    found = matrix.copy()  # its entries may be those of a map
    found.data[np.abs(found.data) < _WEIGHT_MIN] = 0
    found.eliminate_zeros()
    found.sum_duplicates()
    return found


def _whole(mesh: TriangleMesh, labels: ArrayLike) -> NDArray[Any]:
    given = np.asarray(labels)
    if isinstance(labels, np.ma.MaskedArray) or not isinstance(labels, np.ndarray | list | tuple):
        placed = at_vertices(mesh, labels, "labels")
        given = placed.astype(np.int64) if np.array_equal(placed, np.rint(placed)) else placed
    if given.ndim != 1 or given.dtype.kind not in "iu":
        raise FunctionError(
            f"labels have shape {given.shape} of {given.dtype}; expected whole numbers, one per "
            "vertex"
        )
    return given

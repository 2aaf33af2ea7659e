"""Correspondences between two surfaces, and the transfer of functions, labels and points."""

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
from abfm.maps.spherical import SphereLayout, map_through_sphere
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.mesh import TriangleMesh
from abfm.types import File, FloatArray, IntArray

TransferMethod: TypeAlias = Literal["point", "area"]
_COVERAGE_FACES_MAX = 20_000  # faces sampled for the coverage
_WEIGHT_MIN = 1e-12  # smaller interpolation weights count as 0

_ROUNDING = 1e-9  # distance in sqrt(area) below which positions are equal


class Candidate(NamedTuple):
    """A candidate for the initial map: the method that found it, and its cost."""

    name: str  # name of the method, see `abfm.registration.initial.methods`
    cost: float  # lower is better; NaN if it was not compared with another candidate


class Correspondence(Display):
    """A map from surface B to surface A and a map in the opposite direction.

    Parameters
    ----------
    points : PointMap
        Map from B to A: the point of A for each vertex of B.
    back : PointMap, optional
        Map from A to B. By default, each vertex of A is mapped to the point of B whose image on A
        is closest to it (`PointMap.inverse`).

    Attributes
    ----------
    candidates : tuple of Candidate
        Candidates that were compared if this is an initial map: the chosen one first, then the
        others by ascending cost.

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
                raise AbfmError(
                    "back is a map between other surfaces than points; expected a map from the "
                    "codomain of points to its domain"
                )
        self._points, self._back = points, back

    @classmethod
    def through_sphere(
        cls, a: TriangleMesh, b: TriangleMesh, sphere_a: ArrayLike, sphere_b: ArrayLike
    ) -> Correspondence:
        """Return the correspondence of points that have the same direction on a common sphere.

        ``sphere_a`` (V_A, 3) and ``sphere_b`` (V_B, 3) are the directions of the vertices from the
        centre of the sphere. Points inside faces are mapped exactly, in both directions.
        """
        return _ThroughSphere(SphereLayout(a, sphere_a), SphereLayout(b, sphere_b))

    @classmethod
    def of_same_faces(cls, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        """Return the correspondence of two meshes with the same faces.

        Corresponding points have the same face number and the same barycentric weights.
        """
        if not np.array_equal(a.faces, b.faces):
            raise AbfmError(
                f"the surfaces have {len(a.faces)} and {len(b.faces)} faces, which differ; "
                "a map by vertex numbers needs meshes with the same faces"
            )
        return cls(_by_number(b, a), _by_number(a, b))

    @property
    def points(self) -> PointMap:
        """Map from B to A: the point of A for each vertex of B."""
        return self._points

    @property
    def a(self) -> TriangleMesh:
        """Surface A."""
        return self.points.codomain

    @property
    def b(self) -> TriangleMesh:
        """Surface B."""
        return self.points.domain

    @cached_property
    def back(self) -> PointMap:
        """Map from A to B: the point of B for each vertex of A."""
        return self.points.inverse() if self._back is None else self._back

    def transfer(self, h: ArrayLike, by: TransferMethod = "point") -> FloatArray:
        """Transfer a function of A, (V_A,) or (V_A, C), to B, (V_B,) or (V_B, C).

        With ``by="point"`` the value at a vertex of B is that of the corresponding point of A,
        interpolated linearly inside faces. With ``by="area"`` it is a weighted mean over the
        vertices of A around that point, see `to_matrix`. Values that are not finite give values
        that are not finite.
        """
        given = self.a.restrict(as_values(self.a, h, "h"))
        transferred: FloatArray = _without_zeros(self.to_matrix(by)) @ given
        return transferred

    def transfer_labels(self, labels: ArrayLike, by: TransferMethod = "point") -> IntArray:
        """Transfer integer labels of A, (V_A,), to B, (V_B,).

        Each vertex of B gets the label with the largest total weight in its row of `to_matrix`. If
        several labels have this weight, it gets the smallest of them. Labels are never averaged.
        """
        given = self.a.restrict(_integers(self.a, labels))
        values, numbers = np.unique(given, return_inverse=True)
        weights = self.to_matrix(by)
        rows = np.arange(len(numbers))
        one_each = sparse.csr_array(
            (np.ones(len(rows)), (rows, numbers)), shape=(len(rows), len(values))
        )
        shares = sparse.csr_array(weights @ one_each)
        return np.asarray(values[np.asarray(shares.argmax(axis=1)).ravel()])

    def transfer_points(self, points: SurfacePoints | ArrayLike) -> SurfacePoints:
        """Transfer points of A to B.

        Vertices of A can also be given by their indices in its mesh, (P,). Raises AbfmError if the
        points are on another surface.
        """
        given = points if isinstance(points, SurfacePoints) else vertex_points(self.a, points)
        if len(given.mesh.faces) != len(self.a.faces):
            raise AbfmError(
                f"the points are on a surface with {len(given.mesh.faces)} faces; expected points "
                f"on surface A, which has {len(self.a.faces)} faces"
            )
        return self.back.at(given)

    def inverse(self) -> Correspondence:
        """Return the correspondence with A and B exchanged."""
        return Correspondence(self.back, self.points)

    def on_surfaces(self, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        """Return the same correspondence between other surfaces, which have the faces of A and B.

        Images stay in the same faces with the same barycentric weights. For example, a map between
        the spheres of two cortices is converted to a map between the cortices themselves.
        """
        for name, mesh, expected in (("A", a, self.a), ("B", b, self.b)):
            if not np.array_equal(mesh.faces, expected.faces):
                raise ParameterError(
                    f"surface {name} of the map has {len(expected.faces)} faces, which differ from "
                    f"the {len(mesh.faces)} faces of the given surface. Use a map between the "
                    "given surfaces"
                )
        if _same_positions(a, self.a) and _same_positions(b, self.b):
            return self
        return self._on_surfaces(a, b).with_candidates(self.candidates)

    def with_candidates(self, candidates: tuple[Candidate, ...]) -> Correspondence:
        """Return a copy with other candidates for the initial map; the first must be this map."""
        found = object.__new__(type(self))  # copy.copy would convert the maps to arrays and back
        found.__dict__.update(self.__dict__)
        found.candidates = candidates
        return found

    def _on_surfaces(self, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        return Correspondence(
            _between_surfaces(self.points, b, a), _between_surfaces(self.back, a, b)
        )

    def compose(self, other: Correspondence) -> Correspondence:
        """Return the correspondence of A and C, given ``other``, the correspondence of B and C."""
        return Correspondence(
            other.points.followed_by(self.points), self.back.followed_by(other.back)
        )

    def to_matrix(self, by: TransferMethod = "point") -> sparse.csr_array:
        """Return the matrix (V_B, V_A) of `transfer`; each row sums to 1.

        With ``by="point"`` a row has at most three entries. With ``by="area"`` the area of each
        vertex of A is distributed over the vertices of B around its image. The weights of a row are
        the areas that a vertex of B received, divided by their sum. The mean over A is preserved if
        each vertex of B is weighted by the area that it received. Where B is finer than A, areas
        are distributed by the weights of ``by="point"``. This is the adaptive barycentric area
        resampling of Connectome Workbench.
        """
        if by == "point":
            return self.points.to_matrix()
        if by != "area":
            raise ParameterError(f"by is {brief(by)}; expected 'point' or 'area'")
        shares = self.area_shares()
        return sparse.csr_array(sparse.diags_array(1 / shares.sum(axis=1)) @ shares)

    def area_shares(self) -> sparse.csr_array:
        """Return the areas that each vertex of A distributes to the vertices of B, (V_B, V_A).

        A column sums to the area of its vertex of A, or to 0 if no vertex of B is close to its
        image. See `to_matrix` with ``by="area"``.
        """
        forward = _without_zeros(self.points.to_matrix())
        reverse = _without_zeros(sparse.csr_array(self.back.to_matrix().T))
        # vertices of B where the reverse map has all vertices of A that interpolate there
        common = forward.astype(bool).multiply(reverse.astype(bool))
        is_reverse = np.asarray(common.sum(axis=1)).ravel() == np.diff(forward.indptr)
        use_reverse = sparse.diags_array(is_reverse.astype(float))
        use_forward = sparse.diags_array(1.0 - is_reverse)
        areas_b = sparse.diags_array(vertex_areas(self.b))
        chosen = sparse.csr_array(areas_b @ (use_reverse @ reverse + use_forward @ forward))
        given = np.asarray(chosen.sum(axis=0)).ravel()
        factors = np.divide(vertex_areas(self.a), given, out=np.zeros_like(given), where=given > 0)
        return sparse.csr_array(chosen @ sparse.diags_array(factors))

    def to_vertices(self) -> IntArray:
        """Return the nearest vertex of A for each vertex of B, (V_B,)."""
        return self.points.nearest_vertices()

    def distortion(self) -> Distortion:
        """Measure the distortion of each face of B by the map to A, see `PointMap.distortion`.

        Surfaces A and B are scaled to unit area. Faces count as flipped if the map reverses their
        orientation. If it reverses most of the area, as from a left to a right hemisphere, the
        faces whose orientation it preserves count as flipped instead.
        """
        return self._distortion

    @cached_property
    def _distortion(self) -> Distortion:
        points = self.points.onto_mirror() if self.is_mirrored else self.points
        return points.distortion().scaled(self.b.length_scale / self.a.length_scale)

    @cached_property
    def is_mirrored(self) -> bool:
        """Whether the map to A reverses the orientation of more than half of the area of B."""
        found = PointMap(self.b, self.a, self.points.faces, self.points.barycentric).distortion()
        return bool(found.weights[found.flipped].sum() > found.weights.sum() / 2)

    def flipped_by_vertices(self) -> int:
        """Return the number of faces of A that flip if its vertices are moved to their images on B.

        The moved faces are flat triangles, as in surface files such as sphere.reg.
        """
        flipped = int(flipped_triangles(self.b, self.back.positions[self.a.faces]).sum())
        return len(self.a.faces) - flipped if self.is_mirrored else flipped

    def coverage(self) -> float:
        """Return the share of A's area, 0 to 1, that the map from B covers.

        A face is covered if its centroid, mapped to B and back to A, returns within the length of
        the face's longest edge. If A has more than 20,000 faces, 20,000 evenly chosen ones are
        measured.
        """
        count = len(self.a.faces)
        sample = np.linspace(0, count - 1, min(count, _COVERAGE_FACES_MAX)).astype(np.int64)
        lengths = edge_lengths(self.a)[self.a.face_edges[sample]].max(axis=1)
        centroids = SurfacePoints(self.a, sample, np.full((len(sample), 3), 1 / 3))
        returned = self.points.at(self.back.at(centroids))
        is_covered = returned.distances_from(centroids.positions) <= lengths
        areas = face_areas(self.a)[sample]
        return float(areas[is_covered].sum() / areas.sum())

    def round_trip(self) -> RoundTrip:
        """Measure how far vertices of B move by the map to A and back, in mean edge lengths."""
        return round_trip(self.points, self.back.at)

    def accuracy(self, truth: ArrayLike | None = None, count_max: int = 1000) -> MapAccuracy:
        """Measure geodesic errors of the map from B to A, see `abfm.maps.map_accuracy`.

        ``truth`` (V_B,) is the true vertex of A for each vertex of B, by default the vertex with
        the same number. At most ``count_max`` vertices are measured.
        """
        return map_accuracy(self.points, truth, count_max)

    def arrays(self) -> dict[str, Any]:
        """Return the arrays that `save` writes: both meshes (prefix ``a_`` for A) and both maps."""
        meshes = results.mesh_arrays(self.b) | {
            f"a_{name}": array for name, array in results.mesh_arrays(self.a).items()
        }
        return meshes | self._point_arrays()

    def _point_arrays(self) -> dict[str, Any]:
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
        """Write a file (``.npz``, no pickles).

        An interrupted call leaves no partial file. Raises ResultError if the file cannot be
        written.
        """
        results.save_arrays(path, self.arrays(), results.CORRESPONDENCE)

    def __reduce__(self) -> tuple[Any, ...]:
        return _between, (self.a, self.b, self._point_arrays())

    def __repr__(self) -> str:
        return f"{type(self).__name__}(a={self.a!r}, b={self.b!r})"


class _ThroughSphere(Correspondence):
    """A correspondence through a common sphere; its file also has the vertices' directions."""

    def __init__(self, a: SphereLayout, b: SphereLayout) -> None:
        super().__init__(map_through_sphere(b, a), map_through_sphere(a, b))
        self._layouts = a, b

    def _point_arrays(self) -> dict[str, Any]:
        a, b = self._layouts
        return super()._point_arrays() | {"a_sphere": a.directions, "sphere": b.directions}

    def inverse(self) -> Correspondence:
        return _ThroughSphere(*self._layouts[::-1])

    def _on_surfaces(self, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
        pairs = zip((a, b), self._layouts, strict=True)
        return _ThroughSphere(*(SphereLayout(mesh, layout.directions) for mesh, layout in pairs))


def correspondence_of(arrays: results.Arrays) -> Correspondence:
    """Create a correspondence from `Correspondence.arrays`; AbfmError or ValueError if invalid."""
    return _between(results.mesh_of(arrays, "a_"), results.mesh_of(arrays), arrays)


def load_correspondence(path: File) -> Correspondence:
    """Read a file written by `abfm.Correspondence.save`.

    Raises ResultError if the file is missing, damaged, or contains no correspondence.
    """
    return results.loaded(path, results.CORRESPONDENCE, correspondence_of)


def _between(a: TriangleMesh, b: TriangleMesh, arrays: results.Arrays) -> Correspondence:
    keys = "candidates", "candidate_costs"
    names, costs = (arrays[key].tolist() if key in arrays else [] for key in keys)
    candidates = tuple(Candidate(*each) for each in zip(names, costs, strict=True))
    return _of_points(a, b, arrays).with_candidates(candidates)


def _of_points(a: TriangleMesh, b: TriangleMesh, arrays: results.Arrays) -> Correspondence:
    points = PointMap(b, a, arrays["image_faces"], arrays["image_barycentric"])
    back = PointMap(a, b, arrays["back_faces"], arrays["back_barycentric"])
    if "sphere" in arrays and "a_sphere" in arrays:
        return Correspondence.through_sphere(a, b, arrays["a_sphere"], arrays["sphere"])
    if np.array_equal(a.faces, b.faces) and _is_by_number(points) and _is_by_number(back):
        return Correspondence.of_same_faces(a, b)
    nearest = points.inverse()
    if np.allclose(nearest.positions, back.positions, rtol=0, atol=_ROUNDING * b.length_scale):
        back = PointMap(a, b, back.faces, back.barycentric, interior_map=nearest.interior_map)
    return Correspondence(points, back)


def _by_number(domain: TriangleMesh, codomain: TriangleMesh) -> PointMap:
    def interior_map(points: SurfacePoints) -> SurfacePoints:
        return SurfacePoints(codomain, points.faces, points.barycentric)

    return PointMap.of_points(domain, vertex_points(codomain), interior_map)


def _is_by_number(points: PointMap) -> bool:
    expected = vertex_points(points.codomain)
    same = np.array_equal(points.faces, expected.faces)
    return same and np.array_equal(points.barycentric, expected.barycentric)


def _same_positions(one: TriangleMesh, other: TriangleMesh) -> bool:
    return one is other or np.array_equal(one.vertices, other.vertices)


def _between_surfaces(points: PointMap, domain: TriangleMesh, codomain: TriangleMesh) -> PointMap:
    """Replace the surfaces of a map by ``domain`` and ``codomain``, which have the same faces."""
    original = points.interior_map

    def interior_map(given: SurfacePoints) -> SurfacePoints:
        assert original is not None
        found = original(SurfacePoints(points.domain, given.faces, given.barycentric))
        return SurfacePoints(codomain, found.faces, found.barycentric)

    images = SurfacePoints(codomain, points.faces, points.barycentric)
    return PointMap.of_points(domain, images, None if original is None else interior_map)


def _without_zeros(matrix: sparse.csr_array) -> sparse.csr_array:
    found = matrix.copy()  # the matrix may share its entries with a map
    found.data[np.abs(found.data) < _WEIGHT_MIN] = 0
    found.eliminate_zeros()
    found.sum_duplicates()
    return found


def _integers(mesh: TriangleMesh, labels: ArrayLike) -> NDArray[Any]:
    given = np.asarray(labels)
    if isinstance(labels, np.ma.MaskedArray) or not isinstance(labels, np.ndarray | list | tuple):
        values = at_vertices(mesh, labels, "labels")
        given = values.astype(np.int64) if np.array_equal(values, np.rint(values)) else values
    if given.ndim != 1 or given.dtype.kind not in "iu":
        raise FunctionError(
            f"labels have shape {given.shape} of {given.dtype}; expected (V_A,) integers, one per "
            "vertex"
        )
    return given

"""Pairs of people and of animals with known correspondence, read from public repositories.

Clone these into one folder (and unpack the ``.tgz`` of CATS where they are):

- riccardomarin/SHREC19_matching_humans: people, with matches by FARM;
- silviazuffi/smalr_online: five species with the same faces (SMAL), in the same pose;
- mickare/Deformation-Transfer-for-Triangle-Meshes: poses of a cat and of a lion, and 55 pairs of
  their vertices that correspond;
- Golevka/deformation-transfer: poses of a horse;
- CraGL/Hyperspectral-Inverse-Skinning: poses of an elephant and of a wolf.

Meshes with the same faces are decimated separately, to different counts, so that their faces give
nothing away.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.io import loadmat
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from abfm import AbfmError, TriangleMesh
from abfm.maps import PointMap, SurfacePoints, project_onto_surface
from abfm.mesh.coarsening import coarsened
from abfm.mesh.files import READERS, read_contents
from abfm.mesh.subdivision import subdivided
from abfm.mesh.topology import next_corner
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray, IntArray

ISOMETRIC, OTHER = "isometric", "other species"
PEOPLE = "SHREC19_matching_humans"
SPECIES = "smalr_online/src/annotate_kp_matlab/plys"
CATS = "Deformation-Transfer-for-Triangle-Meshes/models/highpoly"
HORSES = "deformation-transfer/bin"
POSES = "Hyperspectral-Inverse-Skinning/models"

_VERTICES_A, _VERTICES_B = 5000, 4500
_FAR = 0.1  # of sqrt(area): truth that is farther from the surface than this is on a part cut off
_SEED = 7
_KNOWN = 500  # vertices of B whose errors are measured
_LANDMARKS = 5
_CATS_AND_LIONS = ((1, 5), (4, 2), (7, 9), (9, 4), (2, 7), (6, 3), (5, 8), (8, 6))  # poses


@dataclass(frozen=True, eq=False)
class ShapePair:
    """Two shapes, vertices (K,) of B, and the vertices (K,) of A where they belong."""

    name: str
    kind: str
    a: TriangleMesh
    b: TriangleMesh
    known: IntArray
    truth: IntArray

    def error(self, points: PointMap) -> float:
        """Return the mean distance along A between images and truth, over the square root of A's
        area: by shortest paths over edges and pairs of faces that are unfolded, up to 5% too long.
        """
        corners = self.a.faces[points.faces[self.known]]
        places = points.positions[self.known]
        to_corners = np.linalg.norm(self.a.vertices[corners] - places[:, None], axis=2)
        rows = np.arange(len(self.truth))[:, None]
        around = (self._from_truth[rows, corners] + to_corners).min(axis=1)
        straight = np.linalg.norm(places - self.a.vertices[self.truth], axis=1)
        is_near = (corners == self.truth[:, None]).any(axis=1)
        return float(np.where(is_near, straight, around).mean() / self.a.length_scale)

    @cached_property
    def landmarks(self) -> Landmarks:
        """Five of the pairs, as far from each other as possible on B."""
        between = distances_over_surface(self.b, self.known)[:, self.known]
        chosen = [int(between.mean(axis=1).argmax())]
        while len(chosen) < _LANDMARKS:
            chosen.append(int(between[chosen].min(axis=0).argmax()))
        return Landmarks.of_vertices(self.a, self.b, self.truth[chosen], self.known[chosen])

    @cached_property
    def _from_truth(self) -> FloatArray:
        return distances_over_surface(self.a, self.truth)


def distances_over_surface(mesh: TriangleMesh, sources: IntArray) -> FloatArray:
    """Return lengths of shortest paths (S, V) from vertices (S,), in the mesh's units, over edges
    and straight across each edge between the corners opposite to it.
    """
    inner = mesh.edge_slots[~mesh.is_boundary_edge]
    corners = mesh.faces.ravel()
    tips = corners[inner]
    start, end = corners[next_corner(inner[:, 0])], corners[next_corner(next_corner(inner[:, 0]))]
    points = mesh.vertices
    along = points[end] - points[start]
    length = np.linalg.norm(along, axis=1)
    to_tips = points[tips] - points[start][:, None]
    x = np.einsum("etx,ex->et", to_tips, along) / length[:, None]
    y = np.sqrt(np.maximum((to_tips**2).sum(axis=2) - x**2, 0))
    crossing = (x[:, 0] * y[:, 1] + x[:, 1] * y[:, 0]) / y.sum(axis=1)
    is_inside = (crossing >= 0) & (crossing <= length) & (tips[:, 0] != tips[:, 1])
    across = np.hypot(x[:, 0] - x[:, 1], y.sum(axis=1))[is_inside]
    ends = np.concatenate([mesh.edges, tips[is_inside]])
    over = np.linalg.norm(points[mesh.edges[:, 0]] - points[mesh.edges[:, 1]], axis=1)
    count = len(points)
    graph = sparse.coo_array((np.concatenate([over, across]), tuple(ends.T)), shape=(count, count))
    found: FloatArray = dijkstra(graph.tocsr(), directed=False, indices=sources)
    return found


def clean(vertices: FloatArray, faces: IntArray) -> TriangleMesh:
    """Return the largest part of a surface, without repeated faces, its holes closed by fans."""
    sides = np.sort(faces, axis=1)
    proper = (sides[:, 0] != sides[:, 1]) & (sides[:, 1] != sides[:, 2])
    first = np.unique(sides, axis=0, return_index=True)[1]
    faces = faces[np.intersect1d(first, np.flatnonzero(proper))]
    mesh = TriangleMesh(vertices, faces, largest_component=True)
    start = next_corner(mesh.edge_slots[mesh.is_boundary_edge, 0])
    corners = mesh.vertex_ids[mesh.faces].ravel()
    edges = np.stack([corners[next_corner(start)], corners[start]], axis=1)
    centers, fans = [], [mesh.vertex_ids[mesh.faces]]
    for number, loop in enumerate(mesh.boundary_loops):
        own = edges[np.isin(edges[:, 0], mesh.vertex_ids[loop])]
        centers.append(vertices[own[:, 0]].mean(axis=0))
        fans.append(np.column_stack([own, np.full(len(own), len(vertices) + number)]))
    if not centers:
        return mesh
    return TriangleMesh(np.vstack([vertices, centers]), np.vstack(fans))


def _read(path: Path) -> TriangleMesh:
    contents = read_contents(path, READERS, "mesh")
    return clean(contents.vertices, contents.faces)


def pair_of_same_faces(
    name: str,
    kind: str,
    whole: tuple[TriangleMesh, TriangleMesh],
    counts: tuple[int, int] = (_VERTICES_A, _VERTICES_B),
) -> ShapePair:
    """Decimate two meshes (A, B) with the same faces, each by itself, to ``counts`` of vertices,
    and keep where they correspond.
    """
    dense = [subdivided(mesh) if len(mesh.vertices) < 1.5 * counts[0] else mesh for mesh in whole]
    a, b = (coarsened(mesh, count) or mesh for mesh, count in zip(dense, counts, strict=True))
    known = np.sort(np.random.default_rng(_SEED).choice(len(b.vertices), _KNOWN, replace=False))
    on_b = project_onto_surface(whole[1], b.vertices[known])
    places = SurfacePoints(whole[0], on_b.faces, on_b.barycentric).positions
    truth = np.asarray(cKDTree(a.vertices).query(places)[1], dtype=np.int64)
    return ShapePair(name, kind, a, b, known, truth)


def read_marks(path: Path) -> IntArray:
    """Read pairs of vertices (K, 2) from lines such as ``- "2653:1316"  # left paw``."""
    return np.array(re.findall(r'"(\d+):(\d+)"', path.read_text()), dtype=np.int64)


def people(folder: Path, count: int) -> Iterator[ShapePair]:
    """Yield pairs of people, drawn at random, always the same ones; those of several parts, one of
    which has to be cut off, are left out where it is known that they matter.
    """

    @cache
    def person(number: str) -> tuple[FloatArray, TriangleMesh, TriangleMesh]:
        found: dict[str, Any] = loadmat(str(folder / f"mat/{number}.mat"), simplify_cells=True)
        shape = next(value for value in found.values() if isinstance(value, dict))
        columns = [shape[axis] for axis in "XYZ"] if "X" in shape else shape["VERT"].T
        vertices = np.column_stack(list(columns)).astype(float)
        whole = clean(vertices, np.asarray(shape["TRIV"], dtype=np.int64) - 1)
        return vertices, whole, coarsened(whole, _VERTICES_A) or whole

    lines = (folder / "PAIRS_list_SHREC19_connectivity.txt").read_text().split()
    order = np.random.default_rng(_SEED).permutation(len(lines))
    given = 0
    for line in (lines[number] for number in order):
        number_b, number_a = line.split(",")
        try:
            (_, whole, b), (places, _, a) = person(number_b), person(number_a)
        except (AbfmError, OSError) as error:
            print(f"{line}: left out, {error}", flush=True)
            continue
        matches = folder / f"matches/FARMgt_txt/{number_b}_{number_a}.txt"
        true = np.array(matches.read_text().split(), dtype=np.int64) - 1
        known = np.sort(np.random.default_rng(_SEED).choice(len(b.vertices), _KNOWN, False))
        own = whole.vertices[whole.vertex_ids < len(true)]
        nearest = whole.vertex_ids[cKDTree(own).query(b.vertices[known])[1]]
        off, truth = cKDTree(a.vertices).query(places[true[nearest]])
        if a.genus or b.genus or np.quantile(off, 0.99) > _FAR * a.length_scale:
            continue
        yield ShapePair(f"{number_b} to {number_a}", ISOMETRIC, a, b, known, np.asarray(truth))
        given += 1
        if given == count:
            return


def animals(folder: Path) -> Iterator[ShapePair]:
    """Yield pairs of animals: the same one in two poses, then different species."""

    def pose(of: str, number: int) -> TriangleMesh:
        return _read(folder / of.format(number))

    cat, lion = (partial(pose, f"{CATS}/{of}-poses/{of}-{{:02d}}.obj") for of in ("cat", "lion"))
    for name, read, b, a in (
        ("cat", cat, 3, 8),
        ("horse", partial(pose, f"{HORSES}/horse-{{:02d}}.obj"), 2, 7),
        ("lion", lion, 1, 6),
        ("elephant", partial(pose, f"{POSES}/elephant-poses/{{}}.obj"), 2, 9),
        ("wolf", partial(pose, f"{POSES}/wolf-all/poses-1/wolf-{{}}.obj"), 1, 5),
    ):
        yield pair_of_same_faces(f"{name} {b} to {a}", ISOMETRIC, (read(a), read(b)))
    of_cat, of_lion = read_marks(folder / CATS / "markers-cat-lion.yml").T
    for number, (at_cat, at_lion) in enumerate(_CATS_AND_LIONS):
        cats = f"cat {at_cat}", cat(at_cat), of_cat
        lions = f"lion {at_lion}", lion(at_lion), of_lion
        (of_b, on_b, known), (of_a, on_a, truth) = (cats, lions)[:: 1 if number % 2 else -1]
        yield ShapePair(f"{of_b} to {of_a}", OTHER, on_a, on_b, known, truth)
    species = {
        name: _read(folder / SPECIES / f"{name}_smpl.ply")
        for name in ("cow", "dog", "hippo", "horse", "tiger")
    }
    for one, other in combinations(species, 2):
        yield pair_of_same_faces(f"{one} to {other}", OTHER, (species[other], species[one]))

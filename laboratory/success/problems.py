"""Random problems, each from its own seed: the same whatever else is drawn."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args
from zlib import crc32

import numpy as np

from abfm.calculus.geodesics import geodesic_distance
from abfm.functions import function
from abfm.maps.symmetry import SymmetryError, detect_symmetry
from abfm.matching.judging.solvability import different_peaks
from abfm.matching.problem import Problem
from abfm.matching.solving.range_bound import range_bound
from abfm.matching.solving.resolution import RESOLVED, resolution
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from laboratory.watched import LEVEL

Family = Literal["gaussian", "one to two", "disc", "eigenfunction", "descriptor"]
FAMILIES: tuple[Family, ...] = get_args(Family)
"""What is matched, by name.

- gaussian: one to another of the same width
- one to two: one to two others, narrower by the root of two, so that what lies above a level keeps
  its area
- disc: the indicator of a geodesic disc to another; the radius is twice the width, where a Gaussian
  has fallen to 0.14
- eigenfunction: of the Laplacian, to the next one
- descriptor: the distance to a landmark and its mirror image, where the surface has a mirror
"""
WIDTHS = (0.05, 0.1, 0.15)
"""Of the source, as fractions of sqrt(area)."""
DISTANCES = {"quarter": (0.2, 0.3), "half": (0.45, 0.55), "far": (0.9, 1.0)}
"""From the source's centre to the target's, as fractions of the largest geodesic distance from
there.
"""

_TURN: tuple[Family, ...] = (
    *("gaussian", "one to two", "disc", "gaussian", "eigenfunction"),
    *("gaussian", "one to two", "descriptor", "gaussian", "disc"),
)
_HIGHEST = 8  # of the eigenfunctions matched
# of the most possible: how far the two targets of one source are from each other
_APART = (0.5, 1.0)
_OFF_MIRROR = 0.2  # of sqrt(area): how far a landmark is from its image


@dataclass(frozen=True, eq=False)
class Trial:
    """A source and a target on a mesh as text, and what kind of problem they make.

    Attributes
    ----------
    mesh_name : str
    index : int
        Number of the problem on its mesh.
    mesh : TriangleMesh
    family : one of `FAMILIES`
    source, target : str
        The functions, as `abfm.function` and the command line read them.
    width : float or None
        One of `WIDTHS`; None for families without.
    distance : str or None
        One of `DISTANCES`; None for families without.
    """

    mesh_name: str
    index: int
    mesh: TriangleMesh
    family: Family
    source: str
    target: str
    width: float | None = None
    distance: str | None = None

    def functions(self) -> tuple[FloatArray, FloatArray]:
        """Return source and target, (V,)."""
        return function(self.mesh, self.source), function(self.mesh, self.target)

    def to_dict(self) -> dict[str, Any]:
        """Return all that tells it from others, whether the mesh resolves it, and what is known to
        be in any flow's way.
        """
        f, g = self.functions()
        edges = resolution(self.mesh, np.stack([f, g], axis=1))
        term = Problem(self.mesh, f, g).functions
        least = range_bound(term)
        return {
            "mesh": self.mesh_name,
            "vertices": len(self.mesh.vertices),
            **{
                key: getattr(self, key)
                for key in ("index", "family", "width", "distance", "source", "target")
            },
            "edges_per_width": edges,
            "resolved": edges >= RESOLVED,
            "least": least,
            "solvable": least <= LEVEL and different_peaks(term) is None,
        }


def success_problems(
    meshes: Mapping[str, TriangleMesh], seed: int = 0, count: int = 10
) -> Iterator[Trial]:
    """Return the first ``count`` problems of every mesh, the first ones of all meshes first.

    Problem k of a mesh depends only on the seed, the mesh and its name: kinds take turns, each mesh
    beginning with another one, and places are random. A descriptor is left out where the mesh has
    no mirror.
    """
    for index in range(count):
        for name, mesh in meshes.items():
            problem = _problem(name, mesh, index, seed)
            if problem is not None:
                yield problem


def _problem(name: str, mesh: TriangleMesh, index: int, seed: int) -> Trial | None:
    key = crc32(name.encode())
    rng = np.random.default_rng([seed, key, index])
    turn = index + key % len(_TURN)
    family = _TURN[turn % len(_TURN)]
    if family == "eigenfunction":
        k = int(rng.integers(1, _HIGHEST + 1))
        return Trial(name, index, mesh, family, f"eigenfunction:{k}", f"eigenfunction:{k + 1}")
    if family == "descriptor":
        landmark = _landmark(mesh, rng)
        if landmark is None:
            return None
        source = f"geodesic:vertex={landmark}"
        return Trial(name, index, mesh, family, source, f"permuted:mirror({source})")
    distance = tuple(DISTANCES)[turn % len(DISTANCES)]
    width = WIDTHS[(turn + turn // len(DISTANCES)) % len(WIDTHS)]  # nine in a row are all pairs
    here, there, beside = (int(mesh.vertex_ids[v]) for v in _places(mesh, rng, DISTANCES[distance]))
    if family == "gaussian":
        source, target = _gaussian(here, width), _gaussian(there, width)
    elif family == "one to two":
        narrow = round(width / np.sqrt(2), 4)
        source, target = (
            _gaussian(here, width),
            f"{_gaussian(there, narrow)} + {_gaussian(beside, narrow)}",
        )
    else:
        source, target = _disc(here, width), _disc(there, width)
    return Trial(name, index, mesh, family, source, target, width, distance)


def _gaussian(vertex: int, width: float) -> str:
    return f"gaussian:vertex={vertex},width={width:g}"


def _disc(vertex: int, width: float) -> str:
    return f"indicator:vertex={vertex},radius={2 * width:g}"


def _places(
    mesh: TriangleMesh, rng: np.random.Generator, between: tuple[float, float]
) -> tuple[int, int, int]:
    """Return a random vertex, one as far from there as asked for, and another such one that is not
    near the second.
    """
    here = int(rng.integers(len(mesh.vertices)))
    distances = geodesic_distance(mesh, [here])
    there = _choice(rng, distances, between)
    low, high = between
    fractions = distances / distances.max()
    ring = (fractions >= low) & (fractions <= high)
    apart = np.where(ring, geodesic_distance(mesh, [there]), 0.0)
    return here, there, _choice(rng, apart, _APART)


def _choice(rng: np.random.Generator, distances: FloatArray, between: tuple[float, float]) -> int:
    """Return a vertex whose distance is between these fractions of the largest, or else nearest to
    their middle.
    """
    fractions = distances / (distances.max() or 1.0)
    low, high = between
    fitting = np.flatnonzero((fractions >= low) & (fractions <= high))
    return (
        int(rng.choice(fitting))
        if len(fitting)
        else int(np.abs(fractions - (low + high) / 2).argmin())
    )


def _landmark(mesh: TriangleMesh, rng: np.random.Generator) -> int | None:
    """Return a vertex, by its number in the file, that is not near its mirror image; None where
    there is no mirror.
    """
    try:
        mirror = detect_symmetry(mesh, "mirror")
    except SymmetryError:
        return None
    offsets = mesh.vertices - mesh.vertices[mirror.vertex_map]
    apart = np.flatnonzero(np.linalg.norm(offsets, axis=1) > _OFF_MIRROR * mesh.length_scale)
    return int(mesh.vertex_ids[rng.choice(apart)]) if len(apart) else None

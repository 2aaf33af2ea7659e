"""Meshes that are no surfaces, or hardly, and mesh files as heavy as their size allows."""

from __future__ import annotations

from random import Random

import numpy as np

from tests.attack.heavy_meshes import HEAVY
from tests.attack.specimens import Specimen
from tests.attack.trial import run
from tests.attack.victim import LARGEST, ROOT, Victim
from tests.mesh_writers import WRITERS
from tests.shapes import icosphere, moebius_arrays, open_cylinder, square, tetrahedron, torus

_SHAPES = (icosphere(0), icosphere(1), torus(6, 5), square(4), open_cylinder(6, 2), tetrahedron())
_NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 5e-324, 1e200, 1e60, 1e-60, 1e9, 0.0, -0.0)
_INDICES = (-1, -(2**31), 2**31 - 1, 10**6)
_HEAVY_ONE_IN = 4


def damaged(random: Random) -> tuple[np.ndarray, np.ndarray, str]:
    """Vertices and faces of a shape to which something was done, and what that was."""
    shape = random.choice(_SHAPES)
    vertices, faces = shape.vertices.copy(), shape.faces.copy()
    done = []
    for _ in range(random.randint(1, 3)):
        face, vertex = random.randrange(len(faces)), random.randrange(len(vertices))
        act = random.choice(_ACTS)
        done.append(act)
        if act == "number":
            vertices[vertex, random.randrange(3)] = random.choice(_NUMBERS)
        elif act == "index":
            faces[face, random.randrange(3)] = random.choice((*_INDICES, len(vertices)))
        elif act == "repeated vertex":
            faces[face, 0] = faces[face, 1]
        elif act == "repeated face":
            faces = np.concatenate([faces, np.roll(faces[face : face + 1], random.randrange(3), axis=1)])
        elif act == "face turned":
            faces[face] = faces[face, ::-1]
        elif act == "face gone":
            faces = np.delete(faces, face, axis=0) if len(faces) > 1 else faces
        elif act == "third face":
            faces = np.concatenate([faces, [[*faces[face, :2], len(vertices)]]])
            vertices = np.concatenate([vertices, [random.choice(_SHAPES).vertices[0] + 5]])
        elif act == "same place":
            vertices[vertex] = vertices[random.randrange(len(vertices))]
        elif act == "near":
            here, there = faces[face, :2] % len(vertices)  # an index may be wrong by now
            offset = vertices[here] - vertices[there]
            vertices[here] = vertices[there] + 10.0 ** random.uniform(-17, -3) * offset
        elif act == "glued":
            faces[faces == vertex] = random.randrange(len(vertices))
        elif act == "two":
            other_faces = faces + len(vertices)
            other_faces[other_faces == len(vertices) + vertex] = random.choice((vertex, len(vertices) + vertex))
            vertices, faces = np.concatenate([vertices, vertices + 5]), np.concatenate([faces, other_faces])
        elif act == "far":
            vertices = vertices + 10.0 ** random.uniform(3, 16)
        elif act == "size":
            vertices = vertices * 10.0 ** random.uniform(-70, 70)
        elif act == "flat":
            vertices[:, random.randrange(3)] *= random.choice((0.0, 1e-13, 1e-9))
        elif act == "few":
            faces = faces[: random.randint(1, 2)]
        elif act == "one-sided":
            vertices, faces = (part.copy() for part in moebius_arrays(random.randint(3, 20)))
        elif act == "back to back":
            faces = np.concatenate([faces, faces[:, ::-1]])
        else:
            vertices = np.insert(vertices, vertex, random.choice(_NUMBERS), axis=0)
    return vertices, faces, ", ".join(done)


_ACTS = (
    "number", "index", "repeated vertex", "repeated face", "face turned", "face gone", "third face", "same place",
    "near", "glued", "two", "far", "size", "flat", "few", "one-sided", "back to back", "unused vertex",
)  # fmt: skip


def broken(seed: int) -> tuple[Specimen, str]:
    """What the seed makes, and what it is called."""
    random = Random(seed)
    if seed % _HEAVY_ONE_IN == 0:
        name = list(HEAVY)[seed // _HEAVY_ONE_IN % len(HEAVY)]
        size = random.choice((10_000, 100_000, 9_000_000))
        return Specimen(name, "mesh", HEAVY[name](size)[:LARGEST]), f"{name} of {size / 1e6:g} MB"
    vertices, faces, done = damaged(random)
    name = random.choice(("a.obj", "a.off", "ascii.ply", "little.ply"))
    if name == "little.ply":
        faces = faces.clip(-(2**31), 2**31 - 1)  # what its corners can hold
    with np.errstate(all="ignore"):
        return Specimen(name, "mesh", WRITERS[name][0](vertices, faces)), f"{name}: {done}"


if __name__ == "__main__":
    with Victim("broken_meshes", "tests.attack.broken_meshes:broken", ROOT / "out" / "attack") as victim:
        run(victim.attempt, __doc__)

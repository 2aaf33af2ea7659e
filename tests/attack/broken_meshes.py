"""Meshes that are no surfaces, or hardly, and mesh files as heavy as their size allows."""

from random import Random

import numpy as np

from tests.attack.heavy_meshes import HEAVY
from tests.attack.specimens import Specimen
from tests.attack.victim import LARGEST, run_victim
from tests.mesh_writers import WRITERS
from tests.shapes import icosphere, moebius_arrays, open_cylinder, square, tetrahedron, torus

_SHAPES = (icosphere(0), icosphere(1), torus(6, 5), square(4), open_cylinder(6, 2), tetrahedron())
_NUMBERS = (
    *(np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 5e-324, 1e200, 1e60, 1e-60, 1e9, 0.0, -0.0),
)
_INDICES = (-1, -(2**31), 2**31 - 1, 10**6)
_HEAVY_ONE_IN = 4


class _Draft:
    """A shape to which something is done at a face and a vertex of it."""

    def __init__(self, random):
        shape = random.choice(_SHAPES)
        self.random = random
        self.vertices, self.faces = shape.vertices.copy(), shape.faces.copy()

    def change(self):
        """Do something, and return what."""
        face, vertex = (self.random.randrange(len(part)) for part in (self.faces, self.vertices))
        act = self.random.choice(tuple(_ACTS))
        _ACTS[act](self, face, vertex)
        return act

    def number(self, _, vertex):
        self.vertices[vertex, self.random.randrange(3)] = self.random.choice(_NUMBERS)

    def index(self, face, _):
        index = self.random.choice((*_INDICES, len(self.vertices)))
        self.faces[face, self.random.randrange(3)] = index

    def repeated_vertex(self, face, _):
        self.faces[face, 0] = self.faces[face, 1]

    def repeated_face(self, face, _):
        again = np.roll(self.faces[face : face + 1], self.random.randrange(3), axis=1)
        self.faces = np.concatenate([self.faces, again])

    def face_turned(self, face, _):
        self.faces[face] = self.faces[face, ::-1]

    def face_gone(self, face, _):
        if len(self.faces) > 1:
            self.faces = np.delete(self.faces, face, axis=0)

    def third_face(self, face, _):
        self.faces = np.concatenate([self.faces, [[*self.faces[face, :2], len(self.vertices)]]])
        place = self.random.choice(_SHAPES).vertices[0] + 5
        self.vertices = np.concatenate([self.vertices, [place]])

    def same_place(self, _, vertex):
        self.vertices[vertex] = self.vertices[self.random.randrange(len(self.vertices))]

    def near(self, face, _):
        here, there = self.faces[face, :2] % len(self.vertices)  # an index may be wrong by now
        offset = self.vertices[here] - self.vertices[there]
        self.vertices[here] = self.vertices[there] + 10.0 ** self.random.uniform(-17, -3) * offset

    def glued(self, _, vertex):
        self.faces[self.faces == vertex] = self.random.randrange(len(self.vertices))

    def two(self, _, vertex):
        count = len(self.vertices)
        others = self.faces + count
        others[others == count + vertex] = self.random.choice((vertex, count + vertex))
        self.vertices = np.concatenate([self.vertices, self.vertices + 5])
        self.faces = np.concatenate([self.faces, others])

    def far(self, *_):
        self.vertices = self.vertices + 10.0 ** self.random.uniform(3, 16)

    def size(self, *_):
        self.vertices = self.vertices * 10.0 ** self.random.uniform(-70, 70)

    def flat(self, *_):
        self.vertices[:, self.random.randrange(3)] *= self.random.choice((0.0, 1e-13, 1e-9))

    def few(self, *_):
        self.faces = self.faces[: self.random.randint(1, 2)]

    def one_sided(self, *_):
        arrays = moebius_arrays(self.random.randint(3, 20))
        self.vertices, self.faces = (part.copy() for part in arrays)

    def back_to_back(self, *_):
        self.faces = np.concatenate([self.faces, self.faces[:, ::-1]])

    def unused_vertex(self, _, vertex):
        self.vertices = np.insert(self.vertices, vertex, self.random.choice(_NUMBERS), axis=0)


# in the order that the seeds count in
_ACTS = {
    act.__name__.replace("_", " ").replace("one ", "one-"): act
    for act in vars(_Draft).values()
    if callable(act) and act.__name__ not in ("__init__", "change")
}


def broken(seed):
    """What the seed makes, and what it is called."""
    random = Random(seed)
    if seed % _HEAVY_ONE_IN == 0:
        name = list(HEAVY)[seed // _HEAVY_ONE_IN % len(HEAVY)]
        size = random.choice((10_000, 100_000, 9_000_000))
        return Specimen(name, "mesh", HEAVY[name](size)[:LARGEST]), f"{name} of {size / 1e6:g} MB"
    draft = _Draft(random)
    done = ", ".join(draft.change() for _ in range(random.randint(1, 3)))
    vertices, faces = draft.vertices, draft.faces
    name = random.choice(("a.obj", "a.off", "ascii.ply", "little.ply"))
    if name == "little.ply":
        faces = faces.clip(-(2**31), 2**31 - 1)  # what its corners can hold
    with np.errstate(all="ignore"):
        return Specimen(name, "mesh", WRITERS[name][0](vertices, faces)), f"{name}: {done}"


if __name__ == "__main__":
    run_victim("broken_meshes", "broken", __doc__)

"""Initial maps by a word, as the command line and the window name them."""

from __future__ import annotations

import numpy as np

from abfm.errors import ParameterError, brief, did_you_mean
from abfm.maps.point_maps import PointMap
from abfm.maps.spherical import SphereLayout, is_sphere, sphere_directions
from abfm.mesh import TriangleMesh, load_mesh
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.given import Given, Initial
from abfm.registration.initial.spheres import OnSphere, rotation_by_functions
from abfm.types import FloatArray

WORDS = ("connectivity", "sphere")


def initial_map(initial: object, given: Given) -> Initial:
    """Return the initial map that a word asks for, or what was given as one; None is chosen by what
    there is.

    ``connectivity``
        Vertex i to vertex i, of surfaces with the same faces.
    ``sphere``, ``sphere:A,B``
        Through spheres, by default the surfaces themselves, else mesh files with their vertices;
        sphere A is turned as the functions ask. ``sphere:mirror`` and ``sphere:mirror,A,B`` see A
        in a mirror first, as between left and right.
    """
    if isinstance(initial, Correspondence):
        _check(given, initial)
        return Initial(initial)
    if isinstance(initial, PointMap):
        found = Correspondence(initial)
        _check(given, found)
        return Initial(found)
    if initial is None:
        initial = _chosen(given)
    if not isinstance(initial, str):
        raise ParameterError(
            f"initial is {brief(initial)}; expected a Correspondence, a PointMap, or a word: "
            f"{', '.join(WORDS)}"
        )
    word, _, rest = initial.partition(":")
    if word == "connectivity":
        return Initial(Correspondence.of_same_faces(given.a, given.b))
    if word == "sphere":
        return _by_spheres(given, [part.strip() for part in rest.split(",") if part.strip()])
    raise ParameterError(
        f"unknown initial map {brief(word)}{did_you_mean(word, WORDS)}; known are "
        f"{', '.join(WORDS)}"
    )


def _chosen(given: Given) -> str:
    if np.array_equal(given.a.faces, given.b.faces):
        return "connectivity"
    if is_sphere(given.a) and is_sphere(given.b):
        return "sphere"
    raise ParameterError(
        f"no initial map can be told from the surfaces alone; give initial=, one of "
        f"{', '.join(WORDS)}, or a map"
    )


def _check(given: Given, found: Correspondence) -> None:
    for name, mesh, own in (("A", given.a, found.a), ("B", given.b, found.b)):
        if not np.array_equal(mesh.faces, own.faces):
            raise ParameterError(f"the initial map is of another surface {name} than the one given")


def _by_spheres(given: Given, words: list[str]) -> Initial:
    mirror = bool(words) and words[0] == "mirror"
    files = words[mirror:]
    if len(files) not in (0, 2):
        raise ParameterError(
            f"sphere:{','.join(words)} names {len(files)} files; expected the spheres of A and of "
            "B, or none where the surfaces are spheres themselves"
        )
    spheres = (
        [_sphere_file(*pair) for pair in zip((given.a, given.b), files, strict=True)]
        if (files)
        else [sphere_directions(given.a), sphere_directions(given.b)]
    )
    directions_a = spheres[0] * [-1, 1, 1] if mirror else spheres[0]
    layouts = SphereLayout(given.a, directions_a), SphereLayout(given.b, spheres[1])
    notes = [
        f"{len(layout.folded)} faces of sphere {name} lie the wrong way round"
        for name, layout in zip("AB", layouts, strict=True)
        if len(layout.folded)
    ]
    if given.f is not None and given.g is not None:
        weights = np.ones(len(given.f)) if given.weights is None else given.weights
        turned = rotation_by_functions(
            OnSphere(layouts[0], given.f, given.mask_a),
            OnSphere(layouts[1], given.g, given.mask_b),
            weights,
        )
        directions_a = turned.rotation.apply(directions_a)
        notes.append(
            f"sphere A was turned by {turned.degrees:.1f} degrees: the functions correlate by "
            f"{turned.correlation:.2f}"
        )
    return Initial(
        Correspondence.through_sphere(given.a, given.b, directions_a, spheres[1]), tuple(notes)
    )


def _sphere_file(mesh: TriangleMesh, path: str) -> FloatArray:
    """Return the directions (V, 3) of a mesh's vertices on the sphere that a file holds."""
    sphere = load_mesh(path)
    if sphere.file_vertex_count == mesh.file_vertex_count and np.array_equal(
        sphere.vertex_ids, mesh.vertex_ids
    ):
        return sphere_directions(sphere)
    raise ParameterError(
        f"{path} has {sphere.file_vertex_count} vertices, and the surface {mesh.file_vertex_count};"
        " give a sphere with the same vertices"
    )

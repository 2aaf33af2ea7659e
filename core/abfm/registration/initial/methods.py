"""Initial maps by a word, as the command line and the window name them."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from abfm.errors import AbfmError, MeshError, ParameterError, brief, did_you_mean
from abfm.functions.sides import warn_of_sides
from abfm.maps.point_maps import PointMap
from abfm.maps.spherical import is_sphere, sphere_directions
from abfm.mesh import TriangleMesh
from abfm.mesh.files import READERS, read_contents
from abfm.registration.correspondence import Candidate, Correspondence
from abfm.registration.initial.alignment import KINDS, closest_after_alignment
from abfm.registration.initial.connectivity import same_connectivity
from abfm.registration.initial.discontinuous_maps import make_continuous
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.map_files import map_from_file
from abfm.registration.initial.map_input import Initial, MapInput
from abfm.registration.initial.searching.search import search_initial_map
from abfm.registration.initial.sphere_maps import (
    LANDMARKS_MIN,
    best_of_spheres,
    sphere_of,
    turned,
)
from abfm.types import FloatArray
from abfm.wording import factor

_LOG2_SHAPE_MAX = 1.2  # mean |log2 R| of a map that was searched: see `_checked`


class InitialMapMethod(NamedTuple):
    """A way to find an initial map: how it is written, in a few words what it is, and itself."""

    form: str
    about: str
    find: Callable[[MapInput, list[str]], Initial]

    @property
    def name(self) -> str:
        return self.form.replace("[", ":").partition(":")[0]


def initial_map(initial: object, given: MapInput) -> Initial:
    """Return the initial map of a word, see `METHODS`, or the given one; None is "auto",
    the best of all candidates that apply. Torn maps are made continuous if neither surface has
    handles (`abfm.maps.continuous_map`); a given map stays as it is.

    Raises
    ------
    AbfmError
        If there is no such word, or the surfaces have no such map.
    """
    if isinstance(initial, PointMap):
        initial = Correspondence(initial)
    if isinstance(initial, Correspondence):
        return Initial(initial.on_surfaces(given.a, given.b))
    if initial is None:
        initial = "auto"
    if not isinstance(initial, str):
        raise ParameterError(
            f"initial is {brief(initial)}; expected a Correspondence, a PointMap, or one of "
            f"{', '.join(word.form for word in METHODS)}"
        )
    rest = initial.partition(":")[2]
    found = method_of(initial).find(given, [p for part in rest.split(",") if (p := part.strip())])
    first = found.correspondence.candidates
    if not first:
        named = found.correspondence.with_candidates((Candidate(initial, np.nan),))
        return found._replace(correspondence=named)
    if len(first) == 1:
        return found
    chosen, then = first[:2]
    ranking = (
        f"initial map: {chosen.name}, cost {chosen.cost:.2f} (next: {then.name}, {then.cost:.2f})"
    )
    return found._replace(notes=(ranking, *found.notes))


def method_of(initial: str) -> InitialMapMethod:
    """Return the way that a text names, or raise a ParameterError, before there are surfaces."""
    name = initial.partition(":")[0]
    for word in METHODS:
        if word.name == name:
            return word
    hint = did_you_mean(name, [word.name for word in METHODS])
    raise ParameterError(
        f"unknown initial map {brief(name)}{hint}; expected one of "
        f"{', '.join(word.form for word in METHODS)}"
    )


def _best(given: MapInput, words: list[str]) -> Initial:
    mirrored = _is_mirrored("auto", words)
    if is_sphere(given.a) and is_sphere(given.b):
        return best_of_spheres(given, (-1,) if mirrored else (1, -1))
    if not mirrored and np.array_equal(given.a.faces, given.b.faces):
        found = _by_numbers(given, [])
        if found.correspondence.distortion().log2_shape.mean <= _LOG2_SHAPE_MAX:
            named = (Candidate("connectivity", np.nan),)
            return found._replace(correspondence=found.correspondence.with_candidates(named))
    return search_initial_map(given, sides=(-1,) if mirrored else (1, -1))


def _by_numbers(given: MapInput, words: list[str]) -> Initial:
    if words:
        raise AbfmError(f"connectivity:{','.join(words)}: nothing can follow connectivity")
    if np.array_equal(given.a.faces, given.b.faces):
        return Initial(Correspondence.of_same_faces(given.a, given.b))
    return Initial(Correspondence(same_connectivity(given.a, given.b)))


def _checked(initial: Initial) -> Initial:
    """Return a map that was searched, with a warning if it distorts shapes too much to be right.

    Over 16 pairs of SHREC'19's people maps with errors below 0.05 of sqrt(area) have a mean
    ``|log2 R|`` of 0.35 to 0.69, those of a cat on a lion of 0.8 to 0.9, and maps by functions
    through spheres, with errors of 0.09 to 0.63, of 1.5 to 3.3.
    """
    shape = initial.correspondence.distortion().log2_shape.mean
    if shape <= _LOG2_SHAPE_MAX:
        return initial
    warning = (
        f"the initial map stretches the surface {factor(shape)} times as much in one direction as "
        "in the other, on average, and may lead elsewhere"
    )
    return initial._replace(warnings=(*initial.warnings, warning))


def _by_landmarks(given: MapInput, words: list[str]) -> Initial:
    mirrored = _is_mirrored("landmarks", words)
    if given.landmarks is None or len(given.landmarks) < LANDMARKS_MIN:
        count = 0 if given.landmarks is None else len(given.landmarks)
        raise ParameterError(
            f"{count} landmarks were given; expected {LANDMARKS_MIN} or more: add some, or "
            "choose another initial map, which fewer landmarks help, too"
        )
    return search_initial_map(given, ("landmarks", "spectral", "closest"), (-1 if mirrored else 1,))


def _closest(given: MapInput, words: list[str]) -> Initial:
    kind = next((kind for kind in KINDS if words in ([], [kind])), None)
    if kind is None:
        raise ParameterError(
            f"closest:{','.join(words)}: expected one of {', '.join(KINDS)}, or nothing"
        )
    points, motion = closest_after_alignment(given.a, given.b, kind, given.landmarks)
    note = (
        f"B was laid on A, {motion.rms:.3f} sqrt(area) from it (RMS): each of its points starts at "
        "the closest one"
    )
    return _checked(make_continuous(given, points, (note,)))


def _searched_by(name: str) -> Callable[[MapInput, list[str]], Initial]:
    return lambda given, words: search_initial_map(
        given, (name,), (-1 if _is_mirrored(name, words) else 1,)
    )


def _of_file(given: MapInput, words: list[str]) -> Initial:
    if not words:
        raise ParameterError("file: needs a name, as in file:map.vts")
    path = ",".join(words)
    found = map_from_file(given.a, given.b, path)
    if isinstance(found, Landmarks):
        raise ParameterError(
            f"{path} holds pairs of points, not a point for every vertex of B: give them as "
            "landmarks"
        )
    return make_continuous(given, found)


def _embedded(given: MapInput, words: list[str]) -> Initial:
    mirrored = _is_mirrored("embedding", words)
    return _checked(turned(given, sphere_of(given.a), sphere_of(given.b), mirrored))


def _spheres(given: MapInput, words: list[str]) -> Initial:
    mirror = bool(words) and words[0] == "mirror"
    files = _two_files(words[mirror:])
    if len(files) not in (0, 2):
        raise ParameterError(
            f"sphere:{','.join(words)} names {len(files)} files; expected the spheres of A and of "
            "B, or none where the surfaces are spheres themselves"
        )
    if files:
        sphere_a, sphere_b = _sphere_file(given.a, files[0]), _sphere_file(given.b, files[1])
    else:
        sphere_a, sphere_b = sphere_directions(given.a), sphere_directions(given.b)
    return turned(given, sphere_a, sphere_b, mirror)


def _two_files(words: list[str]) -> list[str]:
    """Return two names of files, which may have commas: where they can be parted so that both are
    there.
    """
    for count in range(1, len(words)):
        pair = [",".join(words[:count]), ",".join(words[count:])]
        if all(os.path.isfile(os.path.expanduser(name)) for name in pair):
            return pair
    return words


def _sphere_file(mesh: TriangleMesh, path: str) -> FloatArray:
    """Return the directions (V, 3) of a mesh's vertices on the sphere that a file holds."""
    try:
        vertices, faces, _, side = read_contents(path, READERS, "mesh")
    except MeshError as error:
        raise error.in_file(path) from None
    warn_of_sides(mesh, path, side)
    if len(vertices) != mesh.file_vertex_count:
        raise ParameterError(
            f"{path} has {len(vertices)} vertices, and the surface {mesh.file_vertex_count}; give "
            "a sphere with the same vertices"
        )
    with suppress(MeshError):  # a mesh that is merged or cut, as the surface is
        sphere = TriangleMesh(vertices, faces)
        if np.array_equal(sphere.vertex_ids, mesh.vertex_ids):
            return sphere_directions(sphere)
    return sphere_directions(TriangleMesh(vertices[mesh.vertex_ids], mesh.faces))


def _is_mirrored(name: str, words: list[str]) -> bool:
    if words not in ([], ["mirror"]):
        raise ParameterError(f"{name}:{','.join(words)}: expected mirror, or nothing")
    return bool(words)


METHODS = (
    InitialMapMethod(
        "auto[:mirror]",
        "the best of the following that apply; mirrored ones only if they are clearly better",
        _best,
    ),
    InitialMapMethod("connectivity", "vertex i to vertex i, of the same faces", _by_numbers),
    InitialMapMethod(
        "sphere[:[mirror,][A,B]]",
        "through spheres, the surfaces or files A and B; A's turned as the functions ask",
        _spheres,
    ),
    InitialMapMethod(
        "embedding[:mirror]",
        "through spheres that are made of both surfaces, which have no handles",
        _embedded,
    ),
    InitialMapMethod(
        "closest[:similarity|rigid|mirror]",
        "to the closest point, after B was laid on A",
        _closest,
    ),
    InitialMapMethod(
        "spectral[:mirror]",
        "by eigenfunctions and functions, of surfaces that are nearly isometric",
        _searched_by("spectral"),
    ),
    InitialMapMethod(
        "extremities[:mirror]",
        "by the ends of limbs, for surfaces that are not isometric",
        _searched_by("extremities"),
    ),
    InitialMapMethod(
        "landmarks[:mirror]",
        "from three and more landmarks: by distances to them, by eigenfunctions, or closest",
        _by_landmarks,
    ),
    InitialMapMethod(
        "file:MAP",
        "from a file: for each vertex of B its vertex of A, or face and weights",
        _of_file,
    ),
)
"""All ways, by name; ``mirror`` sees A in a mirror first, as from left to right."""

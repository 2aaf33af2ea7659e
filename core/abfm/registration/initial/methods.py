"""Methods for initial maps, by the names that Python, the command line and the window use."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
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
    map_through_spheres,
    sphere_of,
)
from abfm.types import FloatArray
from abfm.wording import counted, factor

_LOG2_SHAPE_MAX = 1.2  # mean |log2 R| of a plausible map, see `_checked`


class InitialMapMethod(NamedTuple):
    """A method that finds an initial map."""

    form: str  # syntax, such as ``closest[:rigid]``
    about: str  # description of the method in a few words
    find: Callable[[MapInput, list[str]], Initial]  # second argument: texts after the colon

    @property
    def name(self) -> str:
        return self.form.replace("[", ":").partition(":")[0]


def initial_map(initial: object, given: MapInput) -> Initial:
    """Return the initial map by a method (a text, see `METHODS`), or a given map as `Initial`.

    None means ``"auto"``, the best of all candidates that apply. Discontinuous maps are made
    continuous if neither surface has handles (`abfm.maps.continuous_map`). A given map is not
    changed. Raises AbfmError if the method is unknown or does not apply to the surfaces.
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
            f"{', '.join(method.form for method in METHODS)}"
        )
    rest = initial.partition(":")[2]
    method = method_of(initial)
    found = method.find(given, [p for part in rest.split(",") if (p := part.strip())])
    if not found.correspondence.candidates:
        named = found.correspondence.with_candidates((Candidate(initial, np.nan),))
        found = found._replace(correspondence=named)
    choice = _choice_notes(method.name, found.correspondence.candidates)
    return found._replace(notes=(*choice, *found.notes))


def _choice_notes(method: str, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """Return a note on the chosen method if several were compared or "landmarks" chose another."""
    chosen, others = candidates[0], candidates[1:]
    name, note = chosen.name, ""
    if method == "landmarks" and name.partition(":")[0] != method:
        name = f"{method} (found by the method {name})"
        note = f"initial map: {name}"
    if others:
        cost, other = f"{chosen.cost:.2f}", f"{others[0].name}, cost {others[0].cost:.2f}"
        note = f"initial map: {name}, the candidate of least cost {cost} (second best: {other})"
        if others[0].cost < chosen.cost:  # among almost equal maps, the most accurate is chosen
            note = f"initial map: {name}, cost {cost} (similar to {other}, but more accurate)"
    return (note,) if note else ()


def method_of(initial: str) -> InitialMapMethod:
    """Return the method of an initial map, such as ``closest:rigid``, or raise a ParameterError."""
    name = initial.partition(":")[0]
    for method in METHODS:
        if method.name == name:
            return method
    hint = did_you_mean(name, [method.name for method in METHODS])
    raise ParameterError(
        f"unknown initial map {brief(name)}{hint}; expected one of "
        f"{', '.join(method.form for method in METHODS)}"
    )


def _best(given: MapInput, options: list[str]) -> Initial:
    mirrored = _is_mirrored("auto", options)
    if is_sphere(given.a) and is_sphere(given.b):
        return best_of_spheres(given, (-1,) if mirrored else (1, -1))
    if not mirrored and np.array_equal(given.a.faces, given.b.faces):
        found = _by_numbers(given, [])
        if found.correspondence.distortion().log2_shape.mean <= _LOG2_SHAPE_MAX:
            named = (Candidate("connectivity", np.nan),)
            return found._replace(correspondence=found.correspondence.with_candidates(named))
    return search_initial_map(given, sides=(-1,) if mirrored else (1, -1))


def _by_numbers(given: MapInput, options: list[str]) -> Initial:
    if options:
        raise AbfmError(
            f"unknown option in connectivity:{','.join(options)}; expected connectivity alone"
        )
    if np.array_equal(given.a.faces, given.b.faces):
        return Initial(Correspondence.of_same_faces(given.a, given.b))
    return Initial(Correspondence(same_connectivity(given.a, given.b)))


def _checked(initial: Initial) -> Initial:
    """Return a map, with a warning if its distortion of shapes is implausible.

    The bound is the mean ``|log2 R|`` 1.2. It separates these maps:

    - 0.35 to 0.69 on 16 pairs of people of SHREC'19, with errors below 0.05 sqrt(area),
    - 0.8 to 0.9 from a cat to a lion,
    - 1.5 to 3.3 through spheres by functions, with errors of 0.09 to 0.63 sqrt(area).
    """
    shape = initial.correspondence.distortion().log2_shape.mean
    if shape <= _LOG2_SHAPE_MAX:
        return initial
    warning = (
        f"the initial map may be wrong: on average it stretches the surface {factor(shape)} times "
        "as much in one direction as in the other"
    )
    return initial._replace(warnings=(*initial.warnings, warning))


def _by_landmarks(given: MapInput, options: list[str]) -> Initial:
    mirrored = _is_mirrored("landmarks", options)
    if given.landmarks is None or len(given.landmarks) < LANDMARKS_MIN:
        count = 0 if given.landmarks is None else len(given.landmarks)
        raise ParameterError(
            f"the number of landmarks is {count}; the initial map 'landmarks' needs at least "
            f"{LANDMARKS_MIN}. Add landmarks, or use the initial map 'auto'"
        )
    return search_initial_map(given, ("landmarks", "spectral", "closest"), (-1 if mirrored else 1,))


def _closest(given: MapInput, options: list[str]) -> Initial:
    kind = next((kind for kind in KINDS if options in ([], [kind])), None)
    if kind is None:
        raise ParameterError(
            f"unknown option in closest:{','.join(options)}; expected closest alone or with one "
            f"of {', '.join(KINDS)}"
        )
    points, motion = closest_after_alignment(given.a, given.b, kind, given.landmarks)
    note = (
        f"B was aligned with A (RMS distance {motion.rms:.3f} sqrt(area)), and each point of B was "
        "mapped to the closest point of A"
    )
    return _checked(make_continuous(given, points, (note,)))


def _searched_by(name: str) -> Callable[[MapInput, list[str]], Initial]:
    return lambda given, options: search_initial_map(
        given, (name,), (-1 if _is_mirrored(name, options) else 1,)
    )


def _from_file(given: MapInput, options: list[str]) -> Initial:
    if not options:
        raise ParameterError("file: has no file name; expected one, as in file:map.vts")
    path = ",".join(options)
    found = map_from_file(given.a, given.b, path)
    if isinstance(found, Landmarks):
        raise ParameterError(
            f"{path} has pairs of points; expected a point of A for every vertex of B. Use the "
            "file as landmarks instead of an initial map"
        )
    return make_continuous(given, found)


def _by_embedding(given: MapInput, options: list[str]) -> Initial:
    mirrored = _is_mirrored("embedding", options)
    return _checked(map_through_spheres(given, sphere_of(given.a), sphere_of(given.b), mirrored))


def _by_spheres(given: MapInput, options: list[str]) -> Initial:
    mirror = bool(options) and options[0] == "mirror"
    files = _two_files(options[mirror:])
    if len(files) not in (0, 2):
        raise ParameterError(
            f"sphere:{','.join(options)} names {counted(len(files), 'file')}; expected 2 (the "
            "spheres of A and B), or none if the surfaces are spheres themselves"
        )
    if files:
        sphere_a, sphere_b = _sphere_file(given.a, files[0]), _sphere_file(given.b, files[1])
    else:
        sphere_a, sphere_b = sphere_directions(given.a), sphere_directions(given.b)
    return map_through_spheres(given, sphere_a, sphere_b, mirror)


def _two_files(options: list[str]) -> list[str]:
    """Join parts of a text between commas to two existing files, whose names may contain commas.

    If there are no such files, return the parts.
    """
    for count in range(1, len(options)):
        pair = [",".join(options[:count]), ",".join(options[count:])]
        if all(os.path.isfile(os.path.expanduser(name)) for name in pair):
            return pair
    return options


def _sphere_file(mesh: TriangleMesh, path: str) -> FloatArray:
    """Read the sphere of a mesh from a file; return the directions (V, 3) of its vertices."""
    try:
        vertices, faces, _, side = read_contents(path, READERS, "mesh")
    except MeshError as error:
        raise error.in_file(path) from None
    warn_of_sides(mesh, path, side)
    if len(vertices) != mesh.file_vertex_count:
        raise ParameterError(
            f"{path} has {len(vertices)} vertices, but the surface has {mesh.file_vertex_count}. "
            "Use the sphere that belongs to this surface"
        )
    with suppress(MeshError):  # the sphere is repaired in the same way as the surface
        sphere = TriangleMesh(vertices, faces)
        if np.array_equal(sphere.vertex_ids, mesh.vertex_ids):
            return sphere_directions(sphere)
    return sphere_directions(TriangleMesh(vertices[mesh.vertex_ids], mesh.faces))


def _is_mirrored(name: str, options: list[str]) -> bool:
    if options not in ([], ["mirror"]):
        raise ParameterError(
            f"unknown option in {name}:{','.join(options)}; expected {name} or {name}:mirror"
        )
    return bool(options)


METHODS = (
    InitialMapMethod(
        "auto[:mirror]",
        "the best map by the methods that apply; a mirrored map only if it is clearly better",
        _best,
    ),
    InitialMapMethod(
        "connectivity", "vertex i to vertex i, for meshes with the same faces", _by_numbers
    ),
    InitialMapMethod(
        "sphere[:[mirror,][A,B]]",
        "by directions on spheres (the surfaces, or files A and B), rotated to fit the functions",
        _by_spheres,
    ),
    InitialMapMethod(
        "embedding[:mirror]",
        "by embeddings of both surfaces in a sphere; the surfaces must have no handles",
        _by_embedding,
    ),
    InitialMapMethod(
        "closest[:similarity|rigid|mirror]",
        "to the closest point, after alignment of B with A",
        _closest,
    ),
    InitialMapMethod(
        "spectral[:mirror]",
        "by eigenfunctions and given functions, for nearly isometric surfaces",
        _searched_by("spectral"),
    ),
    InitialMapMethod(
        "extremities[:mirror]",
        "by the ends of limbs, for surfaces that are not nearly isometric",
        _searched_by("extremities"),
    ),
    InitialMapMethod(
        "landmarks[:mirror]",
        "by three or more landmarks: distances to them, eigenfunctions, or closest points",
        _by_landmarks,
    ),
    InitialMapMethod(
        "file:MAP",
        "from a file: the vertex of A for each vertex of B, or a face and weights",
        _from_file,
    ),
)
"""All methods for initial maps. With ``mirror`` A is reflected first, as for left and right."""

"""Initial maps by a word, as the command line and the window name them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from abfm.errors import AbfmError, ParameterError, brief, did_you_mean
from abfm.maps.continuous_map import continuous_map
from abfm.maps.point_maps import PointMap
from abfm.maps.sphere_embedding import sphere_embedding
from abfm.maps.spherical import SphereLayout, is_sphere, sphere_directions
from abfm.mesh import TriangleMesh, load_mesh, per_mesh
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.alignment import KINDS, closest_after_alignment
from abfm.registration.initial.connectivity import same_connectivity
from abfm.registration.initial.given import Given, Initial
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.landmarks_only import FEWEST, map_from_landmarks
from abfm.registration.initial.spectral import functional_map_start
from abfm.registration.initial.spheres import (
    OnSphere,
    Turned,
    rotation_by_functions,
    rotation_by_landmarks,
)
from abfm.registration.initial.vertex_files import map_from_file
from abfm.types import FloatArray
from abfm.wording import factor

# of 20 maps between people two led elsewhere, with defects of .575 and .577; of those below .55
# none did, of the others four did not
_FAR_FROM_ISOMETRY = 0.55
_RIVAL = 0.9  # of a correlation, or of a defect, from which on another map is as good
_LOG2_SHAPE_MAX = 1.2  # mean |log2 R| of a map that was searched: see `_checked`
_CORRELATION_MIN = 0.3  # of functions on spheres that correspond


class Word(NamedTuple):
    """A way to find an initial map: how it is written, in a few words what it is, and itself."""

    form: str
    about: str
    find: Callable[[Given, list[str]], Initial]

    @property
    def name(self) -> str:
        return self.form.replace("[", ":").partition(":")[0]


def initial_map(initial: object, given: Given) -> Initial:
    """Return the initial map that a word asks for, see `WORDS`, or what was given as one; None is
    chosen by what there is: equal faces, spheres, three landmarks, functions on closed surfaces
    without handles, and else what is closest in space. Torn maps are made continuous where neither
    surface has handles (`abfm.maps.continuous_map`); what was given as a map stays as it is.

    Raises
    ------
    AbfmError
        If there is no such word, or the surfaces have no such map.
    """
    if isinstance(initial, PointMap):
        initial = Correspondence(initial)
    if isinstance(initial, Correspondence):
        return Initial(initial.between(given.a, given.b))
    if initial is None:
        initial = chosen_word(given)
    if not isinstance(initial, str):
        raise ParameterError(
            f"initial is {brief(initial)}; expected a Correspondence, a PointMap, or one of "
            f"{', '.join(word.form for word in WORDS)}"
        )
    rest = initial.partition(":")[2]
    return word_of(initial).find(given, [p for part in rest.split(",") if (p := part.strip())])


def word_of(initial: str) -> Word:
    """Return the way that a text names, or raise a ParameterError, before there are surfaces."""
    name = initial.partition(":")[0]
    for word in WORDS:
        if word.name == name:
            return word
    hint = did_you_mean(name, [word.name for word in WORDS])
    raise ParameterError(
        f"unknown initial map {brief(name)}{hint}; expected one of "
        f"{', '.join(word.form for word in WORDS)}"
    )


def chosen_word(given: Given) -> str:
    """Return the word of the map that is found where none is asked for."""
    if np.array_equal(given.a.faces, given.b.faces):
        return "connectivity"
    if is_sphere(given.a) and is_sphere(given.b):
        return "sphere"
    if given.landmarks is not None and len(given.landmarks) >= FEWEST:
        return "landmarks"
    is_closed = not any(mesh.genus or mesh.boundary_loops for mesh in (given.a, given.b))
    if given.f is not None and is_closed:
        return "embedding"
    return "closest"


def _by_numbers(given: Given, words: list[str]) -> Initial:
    _no_words("connectivity", words)
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


def _made_continuous(
    given: Given, points: PointMap, notes: tuple[str, ...] = (), warnings: tuple[str, ...] = ()
) -> Initial:
    """Return a map that may be torn, made continuous where surfaces have no handles."""
    # between vertices as files keep it
    torn = Correspondence(replace(points, carried=None))
    distortion, faces = torn.distortion(), len(given.b.faces)
    share = (distortion.flipped | (distortion.area <= 0)).sum() / faces
    if share == 0:
        return Initial(torn, notes, warnings)
    told = f"it turns over or collapses {100 * share:.2g}% of the faces"
    if given.a.genus or given.b.genus or torn.is_mirrored:
        return Initial(torn, (*notes, f"the initial map is torn: {told}"), warnings)
    spheres = continuous_map(points)
    found = Correspondence.through_sphere(given.a, given.b, *spheres)
    notes = (*notes, f"the initial map was made continuous, as {told}")
    return Initial(found, notes, warnings)


def _by_landmarks(given: Given, words: list[str]) -> Initial:
    mirrored = _is_mirrored("landmarks", words)
    if given.landmarks is None:
        raise ParameterError("an initial map by landmarks needs landmarks: give three or more")
    return _made_continuous(given, map_from_landmarks(given.a, given.b, given.landmarks, mirrored))


def _closest(given: Given, words: list[str]) -> Initial:
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
    return _checked(_made_continuous(given, points, (note,)))


def _spectral(given: Given, words: list[str]) -> Initial:
    mirrored = _is_mirrored("spectral", words)
    functions = None if given.f is None or given.g is None else (given.f.T, given.g.T)
    points, found = functional_map_start(
        given.a, given.b, given.landmarks, functions, mirrored=mirrored
    )
    warnings = []
    if found.defect > _RIVAL * found.rival:
        warnings.append(
            "another map that leads elsewhere is nearly as good, as on symmetric surfaces: give "
            "landmarks that tell them apart"
        )
    if found.isometry_defect > _FAR_FROM_ISOMETRY:
        warnings.append(
            f"the map is far from an isometry (its defect is {found.isometry_defect:.2f}) and may "
            "lead elsewhere, such as back to front: look at it, or give landmarks"
        )
    return _checked(_made_continuous(given, points, warnings=tuple(warnings)))


def _of_file(given: Given, words: list[str]) -> Initial:
    if not words:
        raise ParameterError("file: needs a name, as in file:map.vts")
    path = ",".join(words)
    found = map_from_file(given.a, given.b, path)
    if isinstance(found, Landmarks):
        raise ParameterError(
            f"{path} holds pairs of points, not a point for every vertex of B: give them as "
            "landmarks"
        )
    return _made_continuous(given, found)


def _embedded(given: Given, words: list[str]) -> Initial:
    mirrored = _is_mirrored("embedding", words)
    return _checked(_turned(given, _made_sphere(given.a), _made_sphere(given.b), mirrored))


_made_sphere = per_mesh(sphere_embedding)  # kept, as functions may change


def _spheres(given: Given, words: list[str]) -> Initial:
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
    return _turned(given, sphere_a, sphere_b, mirror)


def _two_files(words: list[str]) -> list[str]:
    """Return two names of files, which may have commas: where they can be parted so that both are
    there.
    """
    for count in range(1, len(words)):
        pair = [",".join(words[:count]), ",".join(words[count:])]
        if all(os.path.isfile(os.path.expanduser(name)) for name in pair):
            return pair
    return words


def _turned(given: Given, sphere_a: FloatArray, sphere_b: FloatArray, mirror: bool) -> Initial:
    """Return the map through spheres, A's (V_A, 3), maybe seen in a mirror, turned as it fits."""
    sphere_a = sphere_a * [-1, 1, 1] if mirror else sphere_a
    layouts = SphereLayout(given.a, sphere_a), SphereLayout(given.b, sphere_b)
    notes = [
        f"{len(layout.folded)} faces of sphere {name} lie the wrong way round"
        for name, layout in zip("AB", layouts, strict=True)
        if len(layout.folded)
    ]
    turned, warnings = _rotation(given, *layouts), list[str]()
    if turned is not None:
        sphere_a = sphere_a @ turned.rotation.as_matrix().T
        notes.append(_turned_words(turned))
        warnings += _ambiguities(turned)
    elif given.landmarks is not None and len(given.landmarks) >= FEWEST:
        notes.append(
            "sphere A was not turned: the landmarks are in one place, or in opposite ones; give "
            "three that are apart"
        )
    found = Correspondence.through_sphere(given.a, given.b, sphere_a, sphere_b)
    return Initial(found, tuple(notes), tuple(warnings))


def _rotation(given: Given, a: SphereLayout, b: SphereLayout) -> Turned | None:
    if given.f is not None and given.g is not None:
        weights = np.ones(len(given.f)) if given.weights is None else given.weights
        on_a, on_b = OnSphere(a, given.f, given.mask_a), OnSphere(b, given.g, given.mask_b)
        return rotation_by_functions(on_a, on_b, weights)
    marks = given.landmarks
    return None if marks is None or len(marks) < FEWEST else rotation_by_landmarks(a, b, marks)


def _turned_words(turned: Turned) -> str:
    told = f"sphere A was turned by {turned.degrees:.1f} degrees"
    if np.isnan(turned.correlation):
        return f"{told}, as the landmarks ask"
    return f"{told}: the functions correlate by {turned.correlation:.2f}"


def _ambiguities(turned: Turned) -> list[str]:
    """Return why a rotation may be a wrong one."""
    warnings = []
    if turned.correlation < _CORRELATION_MIN:
        warnings.append(
            f"by the best rotation of the spheres the functions correlate by "
            f"{turned.correlation:.2f} only: the surfaces may not correspond"
        )
    if turned.runner_up > _RIVAL:
        warnings.append(
            "another rotation is nearly as good: give more functions, or a map, to tell them apart"
        )
    return warnings


def _sphere_file(mesh: TriangleMesh, path: str) -> FloatArray:
    """Return the directions (V, 3) of a mesh's vertices on the sphere that a file holds."""
    sphere = load_mesh(path)
    if not np.array_equal(sphere.vertex_ids, mesh.vertex_ids):
        raise ParameterError(
            f"{path} has {sphere.file_vertex_count} vertices, and the surface "
            f"{mesh.file_vertex_count}; give a sphere with the same vertices"
        )
    return sphere_directions(sphere)


def _is_mirrored(name: str, words: list[str]) -> bool:
    if words not in ([], ["mirror"]):
        raise ParameterError(f"{name}:{','.join(words)}: expected mirror, or nothing")
    return bool(words)


def _no_words(name: str, words: list[str]) -> None:
    if words:
        raise AbfmError(f"{name}:{','.join(words)}: nothing can follow {name}")


WORDS = (
    Word("connectivity", "vertex i to vertex i, of the same faces", _by_numbers),
    Word(
        "sphere[:[mirror,][A,B]]",
        "through spheres, the surfaces or files A and B; A's turned as the functions ask",
        _spheres,
    ),
    Word(
        "embedding[:mirror]",
        "through spheres that are made of both surfaces, which have no handles",
        _embedded,
    ),
    Word(
        "closest[:similarity|rigid|mirror]",
        "to the closest point, after B was laid on A",
        _closest,
    ),
    Word(
        "spectral[:mirror]",
        "by eigenfunctions and functions, of surfaces that are nearly isometric",
        _spectral,
    ),
    Word(
        "landmarks[:mirror]",
        "from three and more landmarks: by eigenfunctions, or closest once aligned",
        _by_landmarks,
    ),
    Word(
        "file:MAP",
        "from a file: for each vertex of B its vertex of A, or face and weights",
        _of_file,
    ),
)
"""All ways, by name; ``mirror`` sees A in a mirror first, as from left to right."""

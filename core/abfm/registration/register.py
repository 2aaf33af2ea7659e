"""Register one surface to another, by functions on both."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import vertex_areas
from abfm.errors import AbfmWarning, FunctionError, ParameterError
from abfm.functions.circular import phase_warning
from abfm.functions.circular_channels import circular_channels
from abfm.functions.known import filled, known_functions
from abfm.functions.objects import texts_or_values
from abfm.functions.sides import warn_of_mixed_sides
from abfm.functions.spec import files_in
from abfm.maps.distortion import Distortion
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import SurfacePoints
from abfm.matching.bounded import BOUNDED_SHARE, check_bound
from abfm.matching.bounded import limit_distortion as limit_match_distortion
from abfm.matching.match import match
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solvability import is_measured
from abfm.matching.solving.record import Iteration
from abfm.matching.terms.functions import (
    FunctionTerm,
    checked_weights,
    mask_from_input,
    mask_of_known,
)
from abfm.mesh import MeshLike, TriangleMesh, as_meshes
from abfm.parameters import Parameters
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.landmark_pairs import Landmarks, by_surface
from abfm.registration.initial.map_input import MapInput
from abfm.registration.initial.methods import initial_map
from abfm.registration.initial.searching.search import is_searched
from abfm.registration.initial.vertex_numbering import warn_of_numbering
from abfm.registration.registration import Registration
from abfm.types import BoolArray, FloatArray
from abfm.workers.control import Control

Functions: TypeAlias = ArrayLike | str | Sequence[str]
Pairs: TypeAlias = ArrayLike | tuple[SurfacePoints, SurfacePoints] | Landmarks
MEASURED_PARAMETERS = Parameters.of(order=1, alpha=0.03, divergence=1.5)
"""Parameters for measured functions of two surfaces, which are only as alike as two people are.

On a human's cortex and fsaverage5, compared with the norm of second order at about the same change
of shapes (mean log2 R 0.39 and 0.38): held-out curvature 0.614 and 0.571, Dice of labels 0.905 and
0.892.
"""
_OPPOSITE_CORRELATION = -0.3  # a correlation below it tells of another sign
_CONSTANT = 1e-9  # of a function's size: smaller deviations from its mean are rounding
# of the range: least and largest values of functions in one unit differ by less
_RANGE_SHARE_MAX = 0.25


class PreparedRegistration(NamedTuple):
    """What `register` matches: a problem on B, whose source came by the initial map."""

    initial: Correspondence
    problem: Problem
    notes: tuple[str, ...]
    functions: FloatArray | None = None  # A's, (V_A, C), as they are compared
    warnings: tuple[str, ...] = ()  # of the initial map

    def with_match(self, match: Match) -> Registration:
        """Return the registration that a match of the problem makes."""
        return Registration(self.initial, match, self.notes, self.functions, self.warnings)

    def solve(
        self,
        max_distortion: float | None = None,
        on_iteration: Callable[[Iteration], object] | None = None,
        control: Control | None = None,
    ) -> Registration:
        """Return the registration that solving the problem makes, see `register`."""
        found = self.with_match(match(self.problem, on_iteration=on_iteration, control=control))
        return found if max_distortion is None else limit_distortion(found, max_distortion, control)


def register(
    a: MeshLike,
    b: MeshLike,
    f: Functions | None = None,
    g: Functions | None = None,
    *,
    initial: Correspondence | PointMap | str | None = None,
    landmarks: Pairs | None = None,
    parameters: Parameters | None = None,
    mask_a: ArrayLike | None = None,
    mask_b: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    max_distortion: float | None = None,
    circular: bool | float = False,
    on_iteration: Callable[[Iteration], object] | None = None,
    control: Control | None = None,
) -> Registration:
    """Find where on surface A each point of surface B lies, so that functions f of A, carried to B,
    are as near to functions g of B as they can be.

    A's functions come to B by an initial map, and then along the flow of a field on B (`match`).

    Parameters
    ----------
    a, b : TriangleMesh, or whatever `abfm.load_mesh` takes
    f, g : (V_A,) or (V_A, C), and (V_B,) or (V_B, C) arrays, or str, or sequences of str
        One or several channels; texts are functions, see `abfm.function`, each on its own surface.
        Where a value is not finite, such as behind a medial wall, nothing is compared, which is
        told; of texts that are NaN in a file.
        Functions that were measured, or are not in one unit, are compared by their deviations from
        their means in standard deviations, both where the masks are above 0; where they correlate
        by less than -0.3 by the initial map, the sign of A's is turned, and that is told.
    initial : Correspondence, PointMap or str, optional
        See `abfm.registration.initial.methods`; by default chosen by what is given.
    landmarks : (L, 2) array of int, pair of SurfacePoints, or Landmarks, optional
        Vertices, or points, of A and of B that belong together: the flow takes where the initial
        map has A's to B's. Without f and g they are all that is matched. Vertices of a
        `TriangleMesh` are its rows; any other file or object counts its own vertices.
    parameters : Parameters, optional
        By default `MEASURED_PARAMETERS` if the functions are measured, or the initial map was
        searched between two shapes, whose functions are only alike; else ``Parameters()``.
    mask_a, mask_b : (V_A,) and (V_B,) arrays, optional
        Weight of the mismatch at each vertex, not negative. Where it is 0, functions are filled in
        from around, like values that are not finite.
    weights : (C,) array, optional
        Weight of each channel's mismatch, all 0 where landmarks alone are to be matched. Masks and
        weights need functions.
    max_distortion : float, optional
        The most ``|log2 J|`` and ``|log2 R|`` of 99% of the faces, none of which may be folded, see
        `limit_distortion`.
    circular : bool or float
        Whether f and g are phases, which are compared by cosine and sine, or their period: two
        channels for each of theirs, with its weight. Texts may be ``circular:...`` by themselves.

    Raises
    ------
    AbfmError
        If what is given does not fit the surfaces or each other.
    """
    if max_distortion is not None:
        check_bound(max_distortion)
    prepared = prepare(
        a,
        b,
        f,
        g,
        initial=initial,
        landmarks=landmarks,
        parameters=parameters,
        mask_a=mask_a,
        mask_b=mask_b,
        weights=weights,
        circular=circular,
    )
    return prepared.solve(max_distortion, on_iteration, control)


def limit_distortion(
    found: Registration, max_distortion: float, control: Control | None = None
) -> Registration:
    """Return the closest registration on the way of one that keeps a bound: for 99% of the faces
    neither ``|log2 J|`` nor ``|log2 R|`` is more, initial map and flow together, and no face is
    folded, see `abfm.matching.limit_distortion`.

    Where the initial map alone is beyond it, and so is every step of the path, no flow can be
    expected to bring it back: the registration comes back as it is, and a note says so.
    """

    def measure(match: Match) -> Distortion:
        return found.with_match(match).distortion()

    chosen = found.with_match(limit_match_distortion(found.match, max_distortion, measure, control))
    bound = chosen.match.bound
    if bound is None or bound.is_kept:
        return chosen
    first = found.initial.distortion()
    told = f"the initial map alone keeps {max_distortion:g} on only"
    share = f"{100 * first.share_within(max_distortion):.1f}% of the faces"
    could = f"{BOUNDED_SHARE:.0%} of them keep {first.bound_of(BOUNDED_SHARE):.3g}"
    ends = "no flow was looked for that keeps less"
    return chosen.with_match(
        chosen.match, (f"{told} {share}, {first.folded} folded, {could}: {ends}",)
    )


def prepare(
    a: MeshLike,
    b: MeshLike,
    f: Functions | None = None,
    g: Functions | None = None,
    *,
    initial: Correspondence | PointMap | str | None = None,
    landmarks: Pairs | None = None,
    parameters: Parameters | None = None,
    mask_a: ArrayLike | None = None,
    mask_b: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    circular: bool | float = False,
) -> PreparedRegistration:
    """Return the initial map and the problem on B that `register` solves."""
    are_made = tuple(not isinstance(given, TriangleMesh) for given in (a, b))
    a, b = as_meshes(a, b)
    if (f is None) != (g is None):
        raise FunctionError("give both f and g: functions of A and of B to register by")
    marks = None if landmarks is None else _landmarks(a, b, landmarks, are_made)
    if f is None or g is None:
        if marks is None:
            raise FunctionError(
                "give f and g, functions of A and of B to register by, or landmarks"
            )
        if not (mask_a is None and mask_b is None and weights is None):
            raise ParameterError(
                "masks and weights say how much functions count, and there are none: give f and g, "
                "or no masks and weights"
            )
        first = initial_map(initial, MapInput(a, b, landmarks=marks))
        problem = Problem(b, None, None, parameters, **_on_b(first.correspondence, marks))
        return PreparedRegistration(
            first.correspondence, problem, first.notes, None, first.warnings
        )
    f, g = texts_or_values(a, f, "f"), texts_or_values(b, g, "g")
    f, g, weights = circular_channels(f, g, weights, circular)
    for mesh, functions in ((a, f), (b, g)):
        warn_of_mixed_sides(mesh, files_in(functions))
    source, known_a = known_functions(a, f, "f")
    target, known_b = known_functions(b, g, "g")
    phases = phase_warning(a, np.where(known_a, source, np.nan))
    mask_a, mask_b = mask_from_input(a, mask_a, "mask_a"), mask_from_input(b, mask_b, "mask_b")
    on_a, on_b = mask_of_known(mask_a, known_a), mask_of_known(mask_b, known_b)
    # hidden values must neither move along the flow nor count as detail
    source = filled(a, source, known_a if on_a is None else on_a > 0)
    target = filled(b, target, known_b if on_b is None else on_b > 0)
    if len(source) != len(target):
        raise FunctionError(
            f"f has {len(source)} and g {len(target)} channels; give as many of each"
        )
    counts = checked_weights(weights, len(source), "weights", "channel", True)
    if counts.any():
        given = MapInput(a, b, source, target, on_a, on_b, counts, marks)
    else:
        given = MapInput(a, b, mask_a=on_a, mask_b=on_b, landmarks=marks)
    first = initial_map(initial, given)
    found = first.correspondence
    carried = found.transfer(source.T, by="area").T
    masks = [] if on_b is None else [on_b]
    if on_a is not None:
        masks.append(np.clip(found.transfer(on_a), 0, None))
    mask = np.prod(masks, axis=0) if masks else None
    carried, target, source, measured, notes = _comparable(b, carried, target, source, mask, counts)
    if phases and not phase_warning(b, np.concatenate([carried, target])):  # which `Problem` gives
        warnings.warn(phases, AbfmWarning, stacklevel=2)
    # of two shapes that are not one and the same functions are only alike
    approximate = is_searched(found.candidates) and bool(counts.any())
    usual = MEASURED_PARAMETERS if measured or approximate else Parameters()
    problem = Problem(
        b,
        carried.T,
        target.T,
        parameters or usual,
        weights=counts,
        approximate=approximate,
        **({} if marks is None else _on_b(found, marks)),
    ).with_known_values(mask)
    told = (*_unknown("A", known_a, mask_a), *_unknown("B", known_b, mask_b))
    notes = [*first.notes, *told, *notes]
    return PreparedRegistration(found, problem, tuple(notes), source.T.copy(), first.warnings)


def _landmarks(
    a: TriangleMesh, b: TriangleMesh, given: Pairs, are_made: tuple[bool, ...]
) -> Landmarks:
    if isinstance(given, tuple) and all(isinstance(points, SurfacePoints) for points in given):
        on_a, on_b = given
        count = len(on_a.faces)
        given = Landmarks(on_a, on_b, np.ones(count), tuple(map(str, range(count))))
    if isinstance(given, Landmarks):
        for name, mesh, points in (("A", a, given.a), ("B", b, given.b)):
            if not np.array_equal(mesh.faces, points.mesh.faces):
                raise ParameterError(
                    f"landmarks are points of another surface {name} than the one given"
                )
        return given
    pairs = np.asarray(given)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise ParameterError(
            f"landmarks have shape {pairs.shape} of {pairs.dtype}; expected (L, 2) vertices of A "
            "and of B, or two SurfacePoints"
        )
    if len(names := [str(name) for name in getattr(given, "columns", ())]) == 2:
        pairs = pairs[:, by_surface(names, [0, 1])]
    rows = [
        np.array([mesh.local_vertex(k) for k in numbers], dtype=np.int64) if is_made else numbers
        for mesh, numbers, is_made in zip((a, b), pairs.T, are_made, strict=True)
    ]
    found = Landmarks.of_vertices(a, b, *rows)
    warn_of_numbering(a, b, a.vertex_ids[rows[0]], b.vertex_ids[rows[1]], first=0)
    return found


def _on_b(initial: Correspondence, marks: Landmarks) -> dict[str, Any]:
    """Return the landmarks of a problem on B: from where the initial map has A's."""
    pair = initial.transfer_points(marks.a), marks.b
    return {"landmarks": pair, "landmark_weights": marks.weights}


def _unknown(side: str, known: BoolArray, mask: FloatArray | None) -> list[str]:
    """Return a note of how many values that a mask (V,) does not hide are not finite, if any."""
    if mask is not None:
        known = known | (mask == 0)
    count = int(np.count_nonzero(~known))
    what = f"functions of {side} are not finite at {count} of {len(known)} vertices"
    return [f"{what}, where nothing is compared"] if count else []


def _comparable(
    mesh: TriangleMesh,
    source: FloatArray,
    target: FloatArray,
    own: FloatArray,
    mask: FloatArray | None,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, bool, list[str]]:
    """Return both functions (C, V), those that were measured, or have other units, less their means
    over their deviations; A's own (C, V_A), which the source was made of, in the same units;
    whether any was measured that counts; and what is strange.
    """
    areas = vertex_areas(mesh) if mask is None else vertex_areas(mesh) * mask
    if not areas.any():
        raise ParameterError("the masks of A and B have nothing in common: check the initial map")
    unit, notes, measured = mesh.normalized(), [], False
    found, own = (source.copy(), target.copy()), own.copy()
    for c, pair in enumerate(zip(source, target, strict=True)):
        apart = [values - np.average(values, weights=areas) for values in pair]
        sizes = [float(np.sqrt(np.average(each**2, weights=areas))) for each in apart]
        largest = [float(np.abs(values).max()) for values in pair]
        if any(size <= _CONSTANT * most for size, most in zip(sizes, largest, strict=True)):
            continue
        is_rough = is_measured(FunctionTerm(unit, *pair, mask))
        measured |= is_rough and weights[c] > 0
        alike = float(np.average(apart[0] * apart[1], weights=areas)) / (sizes[0] * sizes[1])
        is_turned = is_rough and alike < _OPPOSITE_CORRELATION
        if is_turned:
            notes.append(
                f"channel {c + 1} of A was taken with the other sign, as packages differ in it: by "
                f"the initial map it correlates with B's by {alike:.2f}"
            )
            apart[0] = -apart[0]
        if is_rough or not _have_one_unit(*(values[areas > 0] for values in pair)):
            for values, each, size in zip(found, apart, sizes, strict=True):
                values[c] = each / size
            turned = -1 if is_turned else 1
            own[c] = turned * (own[c] - np.average(source[c], weights=areas)) / sizes[0]
    return *found, own, measured, notes


def _have_one_unit(f: FloatArray, g: FloatArray) -> bool:
    """Tell whether two functions, (n,) each, have about the same least and largest values."""
    span = max(np.ptp(f), np.ptp(g))
    ends = abs(f.min() - g.min()), abs(f.max() - g.max())
    return bool(max(ends) <= _RANGE_SHARE_MAX * span)

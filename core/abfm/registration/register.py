"""Registration of one surface to another by functions and landmarks."""

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
from abfm.functions.missing_values import filled, known_functions
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
from abfm.matching.solving.outlook import expected_seconds
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
from abfm.registration.initial.map_input import Initial, MapInput
from abfm.registration.initial.methods import initial_map
from abfm.registration.initial.searching.search import is_searched
from abfm.registration.initial.vertex_numbering import warn_of_numbering
from abfm.registration.registration import Registration
from abfm.types import BoolArray, FloatArray
from abfm.wording import counted
from abfm.workers.control import Control
from abfm.workers.progress import phase

Functions: TypeAlias = ArrayLike | str | Sequence[str]
Pairs: TypeAlias = ArrayLike | tuple[SurfacePoints, SurfacePoints] | Landmarks
MEASURED_PARAMETERS = Parameters.of(order=1, alpha=0.03, divergence=1.5)
"""Parameters for measured functions on two surfaces, such as the cortices of two subjects.

A human cortex was registered to fsaverage5 with them, and with the norm of second order at about
the same distortion of shapes (mean log2 R 0.39 and 0.38). With these parameters, the correlation of
held-out curvature is 0.614 instead of 0.571. The Dice coefficient of labels is 0.905, not 0.892.
"""
_OPPOSITE_CORRELATION = -0.3  # two functions with a smaller correlation have opposite signs
_CONSTANT = 1e-9  # functions that vary less, relative to their largest value, are constant
_RANGE_SHARE_MAX = 0.25  # extrema that differ by a larger share of the range have different units


class PreparedRegistration(NamedTuple):
    """The input of the solver of `abfm.register`: the initial map, and the problem on B."""

    initial: Correspondence
    problem: Problem
    notes: tuple[str, ...]
    functions: FloatArray | None = None  # (V_A, C), functions of A, scaled as in the problem
    warnings: tuple[str, ...] = ()  # reasons why the initial map may be wrong

    def with_match(self, match: Match) -> Registration:
        """Return the registration that consists of the initial map and a match of the problem."""
        return Registration(self.initial, match, self.notes, self.functions, self.warnings)

    def solve(
        self,
        max_distortion: float | None = None,
        on_iteration: Callable[[Iteration], object] | None = None,
        control: Control | None = None,
    ) -> Registration:
        """Solve the problem and return the registration, see `abfm.register`."""
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
    """Register surface A to surface B by functions on both surfaces, landmarks, or both.

    The result maps each point of B to a point of A. The functions f of A, transferred to B by this
    map, are as close as possible to the functions g of B. An initial map transfers f to B. Then the
    flow of a vector field on B moves the transferred functions toward g (`abfm.match`).

    Parameters
    ----------
    a, b : TriangleMesh, or any other argument of `abfm.load_mesh`
        Surfaces A and B.
    f, g : (V_A,) or (V_A, C), and (V_B,) or (V_B, C) arrays, or str, or sequences of str
        Functions of A and of B, with one or several channels. A string is the text form of a
        function, see `abfm.function`. Values that are not finite, such as NaN behind a medial wall,
        are not compared, and a note reports their number.

        Functions with more than 20 peaks and pits count as measured. Measured functions, and
        functions in different units, are standardized: their mean is subtracted, and the result is
        divided by their standard deviation. Both are computed where both masks are positive. If two
        measured functions correlate by less than -0.3 under the initial map, the sign of A's
        function is changed, and a note reports this.
    initial : Correspondence, PointMap or str, optional
        Initial map or the name of a method, see ``abfm.registration.initial.methods``. By default
        the other arguments decide which methods are tried.
    landmarks : (L, 2) array of int, pair of SurfacePoints, or Landmarks, optional
        Corresponding vertices, or points, of A and B. The initial map transfers the landmarks of A
        to B, and the flow moves them to the landmarks of B. Without f and g only landmarks are
        matched. Vertices of a `TriangleMesh` are counted by its rows; those of any other file or
        object have the numbers of that file or object.
    parameters : Parameters, optional
        Parameters of the match. The default is `MEASURED_PARAMETERS` if the functions are measured,
        or if the initial map was searched between two shapes, whose functions are only similar.
        Otherwise the default is ``Parameters()``.
    mask_a, mask_b : (V_A,) and (V_B,) arrays, optional
        Weight of the mismatch at each vertex, not negative. Where it is 0, or where a value is not
        finite, the functions are interpolated from their surroundings.
    weights : (C,) array, optional
        Weight of the mismatch of each channel. If all weights are 0, only landmarks are matched.
        Masks and weights need functions.
    max_distortion : float, optional
        Bound of the distortion: ``|log2 J|`` (change of area) and ``|log2 R|`` (change of shape)
        are at most this for 99% of the faces. No face may be folded, see `limit_distortion`.
    circular : bool or float
        True if f and g are phases of period 2 pi, or the period of their values. A phase is
        compared by its cosine and sine, two channels with the weight of the phase. A function in
        text form can also be declared as a phase, by ``circular:...``.

    Raises
    ------
    AbfmError
        If an argument does not fit the surfaces or the other arguments.
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
    """Return the registration with the smallest residual whose distortion is within a bound.

    The bound applies to the initial map and the flow together. For 99% of the faces neither
    ``|log2 J|`` nor ``|log2 R|`` is larger than ``max_distortion``, and no face is folded, see
    `abfm.matching.limit_distortion`.

    If the initial map alone and every step of the continuation violate the bound, the result is
    the given registration with an additional note.
    """

    def measure(match: Match) -> Distortion:
        return found.with_match(match).distortion()

    chosen = found.with_match(limit_match_distortion(found.match, max_distortion, measure, control))
    bound = chosen.match.bound
    if bound is None or bound.is_satisfied:
        return chosen
    first = found.initial.distortion()
    note = (
        f"without the flow, the initial map satisfies the bound of distortion {max_distortion:g} "
        f"on only {100 * first.share_within(max_distortion):.1f}% of the faces, and folds "
        f"{counted(first.folded, 'face')}. A bound of {first.bound_of(BOUNDED_SHARE):.3g} would "
        f"hold on {BOUNDED_SHARE:.0%} of the faces. No flow with a smaller distortion was searched"
    )
    return chosen.with_match(chosen.match, (note,))


def _initial_map(initial: object, given: MapInput) -> Initial:
    with phase("initial map", expected_seconds(len(given.b.vertices))):
        return initial_map(initial, given)


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
    """Return the initial map and the problem on B that `abfm.register` solves."""
    are_loaded = tuple(not isinstance(given, TriangleMesh) for given in (a, b))
    a, b = as_meshes(a, b)
    if (f is None) != (g is None):
        raise FunctionError("only one of f and g is given; expected functions f of A and g of B")
    pairs = None if landmarks is None else _as_landmarks(a, b, landmarks, are_loaded)
    if f is None or g is None:
        if pairs is None:
            raise FunctionError(
                "functions and landmarks are missing; expected functions f of A and g of B, or "
                "landmarks"
            )
        if not (mask_a is None and mask_b is None and weights is None):
            raise ParameterError(
                "masks and weights are given without functions. Give f and g, or omit masks and "
                "weights"
            )
        first = _initial_map(initial, MapInput(a, b, landmarks=pairs))
        problem = Problem(b, None, None, parameters, **_landmarks_on_b(first.correspondence, pairs))
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
    # values hidden by a mask must neither move along the flow nor count as detail
    source = filled(a, source, known_a if on_a is None else on_a > 0)
    target = filled(b, target, known_b if on_b is None else on_b > 0)
    if len(source) != len(target):
        raise FunctionError(
            f"f has {counted(len(source), 'channel')} and g has {len(target)}; expected equal "
            "numbers"
        )
    channel_weights = checked_weights(weights, len(source), "weights", "channel", True)
    if channel_weights.any():
        given = MapInput(a, b, source, target, on_a, on_b, channel_weights, pairs)
    else:
        given = MapInput(a, b, mask_a=on_a, mask_b=on_b, landmarks=pairs)
    first = _initial_map(initial, given)
    found = first.correspondence
    transferred = found.transfer(source.T, by="area").T
    masks = [] if on_b is None else [on_b]
    if on_a is not None:
        masks.append(np.clip(found.transfer(on_a), 0, None))
    mask = np.prod(masks, axis=0) if masks else None
    transferred, target, source, measured, notes = _standardized(
        b, transferred, target, source, mask, channel_weights
    )
    # `Problem` itself warns of phases in its functions
    if phases and not phase_warning(b, np.concatenate([transferred, target])):
        warnings.warn(phases, AbfmWarning, stacklevel=2)
    # functions of two different shapes are only similar
    approximate = is_searched(found.candidates) and bool(channel_weights.any())
    default = MEASURED_PARAMETERS if measured or approximate else Parameters()
    problem = Problem(
        b,
        transferred.T,
        target.T,
        parameters or default,
        weights=channel_weights,
        approximate=approximate,
        **({} if pairs is None else _landmarks_on_b(found, pairs)),
    ).with_known_values(mask)
    missing = (*_missing_values("A", known_a, mask_a), *_missing_values("B", known_b, mask_b))
    notes = [*first.notes, *missing, *notes]
    return PreparedRegistration(found, problem, tuple(notes), source.T.copy(), first.warnings)


def _as_landmarks(
    a: TriangleMesh, b: TriangleMesh, given: Pairs, are_loaded: tuple[bool, ...]
) -> Landmarks:
    """Check landmarks given in any form, and return them as points of both surfaces.

    A surface in ``are_loaded`` was loaded here, so its vertices are numbered as in its file.
    """
    if isinstance(given, tuple) and all(isinstance(points, SurfacePoints) for points in given):
        on_a, on_b = given
        count = len(on_a.faces)
        given = Landmarks(on_a, on_b, np.ones(count), tuple(map(str, range(count))))
    if isinstance(given, Landmarks):
        for name, mesh, points in (("A", a, given.a), ("B", b, given.b)):
            if not np.array_equal(mesh.faces, points.mesh.faces):
                raise ParameterError(
                    f"the landmarks of {name} are on a surface with {len(points.mesh.faces)} "
                    f"faces, which differ from the {len(mesh.faces)} faces of the given surface. "
                    "Use landmarks on the given surfaces"
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
        np.array([mesh.local_vertex(k) for k in numbers], dtype=np.int64) if is_loaded else numbers
        for mesh, numbers, is_loaded in zip((a, b), pairs.T, are_loaded, strict=True)
    ]
    found = Landmarks.of_vertices(a, b, *rows)
    warn_of_numbering(a, b, a.vertex_ids[rows[0]], b.vertex_ids[rows[1]], first=0)
    return found


def _landmarks_on_b(initial: Correspondence, pairs: Landmarks) -> dict[str, Any]:
    starts_and_ends = initial.transfer_points(pairs.a), pairs.b
    return {"landmarks": starts_and_ends, "landmark_weights": pairs.weights}


def _missing_values(side: str, known: BoolArray, mask: FloatArray | None) -> list[str]:
    """Return a note with the number of vertices without values, if any; ``known`` is (V,)."""
    if mask is not None:
        known = known | (mask == 0)
    count = int(np.count_nonzero(~known))
    text = (
        f"functions of {side} are not finite at {count} of {len(known)} vertices, "
        "excluded from the comparison"
    )
    return [text] if count else []


def _standardized(
    mesh: TriangleMesh,
    source: FloatArray,
    target: FloatArray,
    source_on_a: FloatArray,
    mask: FloatArray | None,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, bool, list[str]]:
    """Standardize channels (C, V) on B that are measured or have two different units.

    Return source and target, (C, V), and the functions of A, (C, V_A), in the units of the source.
    Also return whether a channel of positive weight is measured, and a list of notes.
    """
    areas = vertex_areas(mesh) if mask is None else vertex_areas(mesh) * mask
    if not areas.any():
        raise ParameterError(
            "the masks of A and B do not overlap under the initial map; check the masks and the "
            "initial map"
        )
    unit, notes, measured = mesh.normalized(), [], False
    found, source_on_a = (source.copy(), target.copy()), source_on_a.copy()
    for c, pair in enumerate(zip(source, target, strict=True)):
        deviations = [values - np.average(values, weights=areas) for values in pair]
        sizes = [float(np.sqrt(np.average(each**2, weights=areas))) for each in deviations]
        largest = [float(np.abs(values).max()) for values in pair]
        if any(size <= _CONSTANT * most for size, most in zip(sizes, largest, strict=True)):
            continue
        is_rough = is_measured(FunctionTerm(unit, *pair, mask))
        measured |= is_rough and weights[c] > 0
        covariance = float(np.average(deviations[0] * deviations[1], weights=areas))
        correlation = covariance / (sizes[0] * sizes[1])
        is_negated = is_rough and correlation < _OPPOSITE_CORRELATION
        if is_negated:
            notes.append(
                f"the sign of channel {c + 1} of A was changed: under the initial map, its "
                f"correlation with channel {c + 1} of B was {correlation:.2f}. Software packages "
                "differ in the signs of measures"
            )
            deviations[0] = -deviations[0]
        if is_rough or not _have_one_unit(*(values[areas > 0] for values in pair)):
            for values, each, size in zip(found, deviations, sizes, strict=True):
                values[c] = each / size
            sign = -1 if is_negated else 1
            mean = np.average(source[c], weights=areas)
            source_on_a[c] = sign * (source_on_a[c] - mean) / sizes[0]
    return *found, source_on_a, measured, notes


def _have_one_unit(f: FloatArray, g: FloatArray) -> bool:
    """Return whether two functions, (n,) each, have similar minima and maxima, as in one unit."""
    span = max(np.ptp(f), np.ptp(g))
    ends = abs(f.min() - g.min()), abs(f.max() - g.max())
    return bool(max(ends) <= _RANGE_SHARE_MAX * span)

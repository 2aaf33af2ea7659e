"""A problem as one value: what is to be matched, with which parameters, from which start."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.calculus.channels import extend_all
from abfm.errors import (
    AbfmError,
    AbfmWarning,
    FunctionError,
    MeshError,
    ParameterError,
    brief,
)
from abfm.flow.continuous_flow import field_on_children
from abfm.functions.circular import warn_of_phases
from abfm.functions.circular_channels import circular_channels
from abfm.functions.family import texts_of
from abfm.functions.files import Permuted, ValuesFile
from abfm.functions.local_shape import Curvature
from abfm.functions.objects import texts_or_values
from abfm.functions.sides import warn_of_mixed_sides
from abfm.functions.spec import files_in, function, functions_in, parse
from abfm.io import results
from abfm.maps.surface_points import SurfacePoints
from abfm.matching.solvability import is_measured
from abfm.matching.terms.data_term import DataTerm, Restriction
from abfm.matching.terms.functions import FunctionTerm, mask_from_input, mask_of_known
from abfm.matching.terms.landmarks import Landmarks, landmarks_of, residual_of_errors
from abfm.mesh import MeshLike, TriangleMesh, as_mesh
from abfm.mesh.subdivision import interpolated, mean_of_children, refined, times_subdivided
from abfm.numerics.real_numbers import real_numbers
from abfm.parameters import AREA_PRESERVING_DIVERGENCE, Parameters
from abfm.reading import from_json
from abfm.types import BoolArray, File, FloatArray

_DIFFERENCE_MAX = 0.5
"""Of its norm: what differs by more at the vertices that stay is another function, such as another
one with the same eigenvalue; coarse distances are off by a tenth."""


class Problem:
    """Find v that minimises ``1/2 int ||v||_alpha^2 dt + 1/(2 sigma^2) ||f_tau - g||^2`` (Eq. 3).

    It never changes, is checked when it is made, and has its data terms on the mesh scaled to unit
    area, in whose units everything is solved.

    Parameters
    ----------
    mesh : TriangleMesh, or whatever `abfm.load_mesh` takes
    f, g : (V,) or (V, C) arrays, or str, or sequences of str
        Source and target, one or several channels; texts are functions, see `abfm.function`, which
        finer meshes evaluate anew. Both None where landmarks alone are to be matched: zero then.
    parameters : Parameters, optional
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative. Where it is 0 both functions are filled
        in harmonically from around: what is given there, NaN included, changes nothing. It is 0
        also where a function is NaN, with a warning.
    weights : (C,) array, optional
        Weight of each channel's mismatch, not negative. All may be 0 where there are landmarks,
        which are then all that is matched.
    start : (M, 4^k F, 3) or (4^k F, 3) array, optional
        Fields to start from, such as an earlier ``match.velocity``, also one found for other
        functions or parameters; those of M segments are averaged over, or repeated in, the N of
        these parameters. Sigma is then not cooled again, which would lead away from a good start,
        unless the parameters have a reach and the start is far from the target. None for zero. They
        may be on the mesh subdivided k times: ``start`` is then their mean over children.
    terms : sequence of DataTerm
        What else is to be matched, on ``mesh.normalized()``.
    landmarks : (L, 2) array of int, or pair of SurfacePoints, optional
        Vertices, or points, and where the flow is to take them, each to its own. Vertices of a
        `TriangleMesh` are its rows; any other file or object counts its own vertices.
        ``1/(2 lambda^2) sum_i w_i d(phi(p_i), q_i)^2`` is added, with the flow ``phi`` to tau,
        distances along the surface, and lambda as the parameters' ``landmark_sigma``.
    landmark_weights : (L,) array, optional
        Weight of each, not negative.
    approximate : bool
        Whether source and target are only alike, such as descriptors of two shapes: they are
        matched as far as left-out patches of the surface gain, as measured functions are.
    circular : bool or float
        Whether f and g are phases, which are compared by cosine and sine, or their period: two
        channels for each of theirs, with its weight. Texts may be ``circular:...`` by themselves.
        None gives no warning if they jump as phases do.

    Raises
    ------
    AbfmError
        If the functions, parameters, mask, weights, start or landmarks do not fit.

    Examples
    --------
    >>> import abfm
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("human_A.off"))
    >>> f, g = (abfm.function(mesh, f"gaussian:vertex={i},width=0.2") for i in (394, 14))
    >>> problem = abfm.Problem(mesh, f, g, abfm.Parameters(goal=0.1))
    >>> print(abfm.match(problem).facts.outcome)
    matched
    """

    mesh: TriangleMesh
    terms: tuple[DataTerm, ...]  # all of them: first that of source and target
    parameters: Parameters
    fine_start: FloatArray | None  # (M, 4^k F, 3)
    # texts of source and target, one each for a channel, empty for one that is given by values
    specs: tuple[tuple[str, ...], tuple[str, ...]]
    functions: FunctionTerm
    landmarks: Landmarks | None
    channels_given: bool  # source and target came as (V, C); else as (V,)

    def __init__(
        self,
        mesh: MeshLike,
        f: ArrayLike | Sequence[str] | None,
        g: ArrayLike | Sequence[str] | None,
        parameters: Parameters | None = None,
        *,
        mask: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        start: ArrayLike | None = None,
        terms: Sequence[DataTerm] = (),
        landmarks: ArrayLike | tuple[SurfacePoints, SurfacePoints] | None = None,
        landmark_weights: ArrayLike | None = None,
        approximate: bool = False,
        circular: bool | float | None = False,
    ) -> None:
        is_made = not isinstance(mesh, TriangleMesh)
        mesh = as_mesh(mesh)
        if not isinstance(parameters, Parameters | None):
            raise ParameterError(
                f"parameters is {brief(parameters)}; expected abfm.Parameters(...)"
            )
        if landmarks is not None and f is None and g is None:
            f = g = np.zeros(len(mesh.vertices))
        f, g = (texts_or_values(mesh, f, "source"), texts_or_values(mesh, g, "target"))
        f, g, weights = circular_channels(f, g, weights, circular)
        warn_of_mixed_sides(mesh, [*files_in(f), *files_in(g)])
        source, target = _values(mesh, f), _values(mesh, g)
        mask = _mask_of_known(mesh, (source, target), mask_from_input(mesh, mask))
        if mask is not None:
            known = mask > 0
            source = _filled_in(mesh, source, known)
            target = _filled_in(mesh, target, known)
        functions = FunctionTerm(
            mesh.normalized(), source, target, mask, weights, approximate=approximate
        )
        functions.refuse_extremes()
        if circular is not None:
            rows = np.concatenate([functions.source, functions.target])
            hidden = None if functions.mask is None else functions.mask == 0
            warn_of_phases(mesh, rows if hidden is None else np.where(hidden, np.nan, rows))
        if landmarks is None:
            _require_weight(functions)
        self.__dict__.update(
            mesh=mesh,
            terms=(functions, *terms),
            parameters=parameters or Parameters(),
            fine_start=_checked_start(start, mesh),
            functions=functions,
            landmarks=landmarks_of(mesh, landmarks, landmark_weights, as_file=is_made),
            channels_given=np.ndim(source) == 2,
            specs=tuple(_specs(given, len(functions.source)) for given in (f, g)),
        )

    @property
    def source(self) -> FloatArray:
        """The source, (V, C), which cannot be written to."""
        return _read_only(self.functions.source.T)

    @property
    def target(self) -> FloatArray:
        """The target, (V, C), which cannot be written to."""
        return _read_only(self.functions.target.T)

    @cached_property
    def start(self) -> FloatArray | None:
        """Fields to start from, on the mesh itself, (M, F, 3), which cannot be written to."""
        fine = self.fine_start
        return None if fine is None else _read_only(mean_of_children(fine, len(self.mesh.faces)))

    @property
    def mask(self) -> FloatArray | None:
        """Weight of the mismatch at each vertex, (V,); None for 1 everywhere."""
        mask = self.functions.mask
        return None if mask is None else _read_only(mask)

    @property
    def weights(self) -> FloatArray:
        """Weight of each channel's mismatch, (C,)."""
        return _read_only(self.functions.weights)

    @property
    def is_of_landmarks(self) -> bool:
        """Whether landmarks are all that is to be matched."""
        return self.landmarks is not None and self.functions.is_constant

    @cached_property
    def divergence(self) -> float:
        """How many times as much as its curl a field's divergence weighs: as given, or by whether
        the functions are measured; the same on coarser and finer meshes.
        """
        given = self.parameters.divergence
        if given is None:
            return 1.0 if is_measured(self.functions) else AREA_PRESERVING_DIVERGENCE
        return given

    def starting_from(self, start: ArrayLike | None) -> Problem:
        """Return the same problem with another start."""
        return self._with(fine_start=_checked_start(start, self.mesh))

    def with_parameters(self, parameters: Parameters) -> Problem:
        """Return the same problem with other parameters."""
        other = self._with(parameters=parameters)
        other.__dict__.pop("divergence", None)
        return other

    def with_specs(self, f: Sequence[str], g: Sequence[str]) -> Problem:
        """Return the same problem with texts of source and target, one each for a channel, which
        they were evaluated by; empty for none.
        """
        count = len(self.functions.source)
        return self._with(specs=tuple(_specs(list(given), count) for given in (f, g)))

    def with_mask(self, mask: FloatArray) -> Problem:
        """Return the same problem with another mask (V,) of source and target."""
        return self._with_functions(self.functions.with_mask(mask))

    def with_known_values(self, mask: FloatArray | None) -> Problem:
        """Return the same problem with a mask (V,), whose functions are known also where it is 0,
        and stay as they are there.
        """
        own = self.functions
        return self._with_functions(own.with_values(own.mesh, own.source, own.target, mask))

    def _with_functions(self, functions: FunctionTerm) -> Problem:
        return self._with(terms=(functions, *self.terms[1:]), functions=functions)

    def subdivided(self) -> Problem:
        """Return the problem on the midpoint subdivision of its mesh, made once.

        Functions that came as text are evaluated anew, but for those of files, of maps of vertices
        and of curvature; these and arrays are interpolated. The mask of an edge is the least of its
        ends, so that what it hides nowhere matters. A start that is not on the subdivision is made
        continuous and goes to the children.

        Raises
        ------
        AbfmError
            If faces have no area that can be divided, or a data term has no place there.
        """
        return self._subdivided

    def refined(self, k: int) -> Problem:
        """Return the problem subdivided k times."""
        return self.subdivided().refined(k - 1) if k else self

    @cached_property
    def _subdivided(self) -> Problem:
        mesh, fine, own = self.mesh, refined(self.mesh, 1), self.functions
        source, target = (
            np.stack([on_subdivision(mesh, *pair) for pair in zip(values, specs, strict=True)])
            for values, specs in zip((own.source, own.target), self.specs, strict=True)
        )
        mask = None if own.mask is None else mask_on_children(mesh, own.mask)
        if mask is not None:
            source, target = (extend_all(fine, each, mask > 0) for each in (source, target))
        unit = fine.normalized()
        functions = own.with_values(unit, source, target, mask)
        functions.function_size = own.function_size
        others = [term.restricted(_Finer(mesh, fine)) for term in self.terms[1:]]
        if None in others:
            raise ParameterError("a data term has no place on a finer mesh: do not refine")
        start, marks = self.fine_start, self.landmarks
        if start is not None and start.shape[1] == len(mesh.faces):
            start = np.stack([field_on_children(mesh, field) for field in start])
        return self._with(
            mesh=fine,
            terms=(functions, *others),
            functions=functions,
            landmarks=marks and marks.subdivided(unit),
            fine_start=start,
            divergence=self.divergence,
        )

    def restricted(self, restriction: Restriction) -> Problem | None:
        """Return the problem on a coarser mesh, without a start; None if there is none."""
        terms = tuple(term.restricted(restriction) for term in self.terms)
        if None in terms:
            return None
        none = ("",) * len(self.functions.source)
        return self._with(
            mesh=restriction.coarse,
            terms=terms,
            functions=terms[0],
            landmarks=self.landmarks and self.landmarks.restricted(restriction.coarse),
            fine_start=None,
            specs=(none, none),
            divergence=self.divergence,
        )

    @cached_property
    def digest(self) -> str:
        """Name of the problem by its content, in hexadecimal digits: the same in every process."""
        digest = hashlib.sha256(b"abfm problem, format 1\n")
        arrays = self.arrays()
        arrays.pop("structure", None)  # from the file's name or metadata
        for piece in results.pieces(arrays):
            digest.update(piece)
        for term in self.terms[1:]:
            digest.update(f"{type(term).__qualname__}\n".encode())
        return digest.hexdigest()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all that it is made of: what files hold, and what the digest is of."""
        parameters = json.dumps(self.parameters.to_dict(), sort_keys=True)
        parts: dict[str, Any] = results.mesh_arrays(self.mesh)
        for index, term in enumerate(self.terms):
            for name, array in term.arrays().items():
                parts[f"{name} of term {index}" if name in parts else name] = array
        parts |= {"parameters": parameters, "channels_given": self.channels_given}
        if self.fine_start is not None:
            parts["start"] = self.fine_start
        if self.landmarks is not None:
            parts |= self.landmarks.arrays()
        parts |= self.spec_arrays()
        return {name: np.asarray(part) for name, part in parts.items()}

    def left(self, carried: FloatArray, errors: FloatArray | None) -> float:
        """Return the residual of functions (C, V) and of landmarks that are so far off,
        (L,), whichever is larger.
        """
        of_functions = self.functions.residual(carried)
        return of_functions if errors is None else max(of_functions, residual_of_errors(errors))

    def spec_arrays(self) -> dict[str, NDArray[Any]]:
        """Return what files hold of the texts, (C,) each; nothing where there are none."""
        if not any(map(any, self.specs)):
            return {}
        return dict(zip(results.SPEC_ENTRIES, map(np.array, self.specs), strict=True))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError."""
        results.save_arrays(path, self.arrays(), results.PROBLEM)

    def __repr__(self) -> str:
        return f"Problem({self.mesh!r}, channels={len(self.functions.source)})"

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"a Problem does not change: make a new one instead of setting {name}")

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs: the terms' mesh is made of the problem's there."""
        kept = ("mesh", "parameters", "fine_start", "channels_given", "specs", "landmarks")
        terms = [copy(term) for term in self.terms]
        for term in terms:
            term.__dict__.pop("mesh", None)
        return {name: self.__dict__[name] for name in kept} | {"terms": terms}

    def __setstate__(self, state: dict[str, Any]) -> None:
        unit = state["mesh"].normalized()
        for term in state["terms"]:
            term.__dict__["mesh"] = unit
        if state["landmarks"] is not None:
            state["landmarks"].mesh = unit
        self.__dict__.update(state, terms=tuple(state["terms"]), functions=state["terms"][0])

    def _with(self, **changes: Any) -> Problem:
        other = copy(self)
        for made in ("digest", "start", "_subdivided"):
            other.__dict__.pop(made, None)
        other.__dict__.update(changes)
        return other


def load_problem(path: File) -> Problem:
    """Read a file of `Problem.save`; ResultError if it is missing, damaged, or no problem."""

    def made(arrays: dict[str, NDArray[Any]]) -> Problem:
        return problem_of(results.mesh_of(arrays), arrays)

    return results.loaded(path, results.PROBLEM, made)


def problem_of(mesh: TriangleMesh, arrays: Mapping[str, NDArray[Any]]) -> Problem:
    """Return the problem of such arrays; functions may have values that are refused today."""
    parameters = Parameters.of(**from_json(str(arrays["parameters"])))
    source, target, weights = (arrays[name] for name in ("source", "target", "weights"))
    marks = [arrays[name] for name in results.LANDMARK_ENTRIES if name in arrays]
    functions = FunctionTerm(
        mesh.normalized(),
        source,
        target,
        arrays.get("mask"),
        weights,
        approximate="approximate" in arrays,
    )
    if not marks:
        _require_weight(functions)
    zero = np.zeros(len(mesh.vertices))
    none = [""] * len(functions.source)
    specs = [arrays[name].tolist() if name in arrays else none for name in results.SPEC_ENTRIES]
    return Problem(mesh, zero, zero, parameters)._with(
        terms=(functions,),
        functions=functions,
        channels_given=bool(arrays["channels_given"]),
        fine_start=_checked_start(arrays.get("start"), mesh),
        specs=tuple(map(tuple, specs)),
        landmarks=_landmarks_of_file(mesh, marks),
    )


def check_fields(velocity: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    """Return fields of the shape (N, F, 3), finite; one field may come as (F, 3)."""
    field = real_numbers(velocity, name, ParameterError)
    if field.shape == shape[1:] and shape[0] == 1:
        field = field[None]
    if field.shape != shape:
        raise ParameterError(f"{name} has shape {field.shape}; expected {shape}")
    if not np.isfinite(field).all():
        raise ParameterError(f"{name} has values that are not finite")
    return field


def _checked_start(start: ArrayLike | None, mesh: TriangleMesh) -> FloatArray | None:
    if start is None:
        return None
    fields = real_numbers(start, "start", ParameterError)
    count, faces = max(len(fields), 1) if fields.ndim == 3 else 1, len(mesh.faces)
    with suppress(MeshError, IndexError):
        faces *= 4 ** times_subdivided(fields.shape[-2], mesh)
    return _read_only(check_fields(fields, (count, faces, 3), "start").copy())


def _require_weight(functions: FunctionTerm) -> None:
    if not functions.weights.any():
        raise ParameterError(
            "weights are zero everywhere; give a channel one above 0, or landmarks, which are then "
            "all that is matched"
        )


def _landmarks_of_file(mesh: TriangleMesh, arrays: list[NDArray[Any]]) -> Landmarks | None:
    if not arrays:
        return None
    if len(arrays) != len(results.LANDMARK_ENTRIES):
        raise ValueError(f"it lacks some of {', '.join(results.LANDMARK_ENTRIES)}")
    faces, barycentric, weights = arrays
    pair = tuple(SurfacePoints(mesh, faces[:, k], barycentric[:, k]) for k in range(2))
    return landmarks_of(mesh, pair, weights)


def mask_on_children(mesh: TriangleMesh, mask: FloatArray) -> FloatArray:
    """Return a mask (V,) on the subdivided mesh: on an edge the least of its ends."""
    return np.concatenate([mask, mask[mesh.edges].min(axis=1)])


@dataclass(frozen=True)
class _Finer:
    """How data terms come to a finer mesh, by what they come to coarser ones."""

    mesh: TriangleMesh
    coarse: TriangleMesh

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        return np.moveaxis(interpolated(self.mesh, np.moveaxis(f, -1, 0)), 0, -1)


def _values(mesh: TriangleMesh, given: Any) -> FloatArray:
    if (texts := texts_of(given)) is None:
        return np.asarray(given)
    values = [function(mesh, text, may_be_unknown=True) for text in texts]
    return values[0] if isinstance(given, str) else np.stack(values, axis=1)


def _mask_of_known(
    mesh: TriangleMesh, functions: tuple[FloatArray, FloatArray], mask: FloatArray | None
) -> FloatArray | None:
    """Return a mask (V,) that is 0 also where a function is NaN; None if nothing is masked."""
    missing = np.zeros(len(mesh.vertices), dtype=bool)
    for values in functions:
        if values.ndim in (1, 2) and np.isnan(values).any():
            rows = mesh.restrict(values)
            missing |= np.isnan(rows.reshape(len(rows), -1)).any(axis=1)
    if mask is not None:
        missing &= mask > 0
    found = mask_of_known(mask, ~missing)
    if not missing.any() or found is None:
        return found
    if not found.any():
        raise FunctionError("there is no vertex where source and target both have a value")
    count = np.count_nonzero(missing)
    text = f"{count:,} of {len(missing):,} vertices have no value (NaN) and are not compared"
    warnings.warn(text, AbfmWarning, stacklevel=3)
    return found


def _filled_in(mesh: TriangleMesh, values: FloatArray, known: BoolArray) -> FloatArray:
    """Return functions (V,) or (V, C), filled in where they are not known (V,)."""
    if known.all() or values.ndim not in (1, 2) or values.size == 0:
        return values
    array = mesh.restrict(values)
    rows = np.where(known, array.reshape(len(array), -1).T, 0.0)
    if np.isfinite(rows).all():
        rows = extend_all(mesh, rows, known)
    return rows.T.reshape(array.shape)


def _specs(given: Any, count: int) -> tuple[str, ...]:
    if (known := texts_of(given)) is None:
        return ("",) * count
    if len(known) != count:
        raise ParameterError(f"{len(known)} texts of {count} channels; give one each, or ''")
    texts = (str(parse(text)) if text else "" for text in known)
    return tuple(text if text.isprintable() else "" for text in texts)  # files hold no others


def _read_only(array: FloatArray) -> FloatArray:
    view = array.view()
    view.flags.writeable = False
    return view


def on_subdivision(mesh: TriangleMesh, values: FloatArray, spec: str = "") -> FloatArray:
    """Return a function (V,) on the subdivided mesh, (V + E,): by its spec, if it has one that
    means the same there, else interpolated.
    """
    fine = refined(mesh, 1)
    if spec and _is_meaningful(spec):
        try:
            anew = function(fine, spec)
        except AbfmError:
            return interpolated(mesh, values)
        if np.linalg.norm(anew[: len(values)] - values) <= _DIFFERENCE_MAX * np.linalg.norm(values):
            return anew
    return interpolated(mesh, values)


def _is_meaningful(spec: str) -> bool:
    """Return whether it needs no file, and no curvature, which is 0 at middles of flat edges."""
    try:
        parts = functions_in(parse(spec))
    except AbfmError:
        return False
    return not any(isinstance(part, ValuesFile | Permuted | Curvature) for part in parts)

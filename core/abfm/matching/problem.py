"""The class `Problem`: functions, landmarks, parameters and start of a match."""

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
from abfm.errors import AbfmError, AbfmWarning, FunctionError, MeshError, ParameterError, brief
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
from abfm.wording import counted

_DIFFERENCE_MAX = 0.5
"""Largest difference of a function that was evaluated again, relative to its norm.

A larger difference at the original vertices means another function, such as another eigenfunction
of the same eigenvalue. Distances on coarse meshes have errors of a tenth."""


class Problem:
    """A matching problem: find the field whose flow advects a source to a target.

    The field ``v`` minimises ``1/2 int ||v||_alpha^2 dt + 1/(2 sigma^2) ||f_tau - g||^2`` (Eq. 3).
    A problem is immutable and is checked when it is made. Its data terms refer to the mesh scaled
    to unit area, and so does the solver.

    Parameters
    ----------
    mesh : TriangleMesh, or a mesh as for `abfm.load_mesh`
    f, g : (V,) or (V, C) arrays, or str, or sequences of str
        Source and target with one or several channels. Strings are function specs, see
        `abfm.function`; refined meshes evaluate them again. Both may be None if only landmarks are
        matched, and are zero then.
    parameters : Parameters, optional
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative. Where it is 0, both functions are
        extended harmonically from the surrounding vertices, so their values there have no effect,
        even if they are NaN. Vertices at which a function is NaN are masked, with a warning.
    weights : (C,) array, optional
        Weight of the mismatch of each channel, not negative. All may be 0 if there are landmarks;
        then only these are matched.
    start : (M, 4^k F, 3) or (4^k F, 3) array, optional
        Initial fields, such as ``match.velocity`` of a match with other functions or parameters.
        Fields of M segments are averaged over, or repeated in, the N segments of the parameters.
        With a start, sigma begins at its last value, as a larger one would lead away from a good
        start. If the parameters have a reach and the start misses the target, the search begins
        anew. Measured functions without a given sigma use no start, as it was fitted to held-out
        patches. Fields may be defined on the mesh subdivided k times; the attribute ``start`` is
        then their mean over child faces. The default is zero.
    terms : sequence of DataTerm
        Additional data terms, on ``mesh.normalized()``.
    landmarks : (L, 2) array of int, or pair of SurfacePoints, optional
        Landmarks and their targets, as vertices or points of the surface. Vertices of a
        `TriangleMesh` are its rows; for any
        other mesh they are numbers of the file or object. Landmarks add ``1/(2 lambda^2) sum_i w_i
        d(phi(p_i), q_i)^2`` to the energy, where ``phi`` is the flow to
        tau, d the distance along the surface, and lambda the parameter ``landmark_sigma``.
    landmark_weights : (L,) array, optional
        Weight of each landmark, not negative.
    approximate : bool
        Whether source and target match only approximately, such as descriptors of two shapes. Like
        measured functions, such functions are matched as long as held-out patches of the surface
        improve.
    circular : bool or float
        True if f and g are phases, or their period. Each phase is replaced by two channels, its
        cosine and sine, with the same weight. Specs may use ``circular:...`` instead. None disables
        the warning about functions that jump like phases.

    Raises
    ------
    AbfmError
        If an argument has a wrong shape or value.

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
    terms: tuple[DataTerm, ...]  # the first one is the term of source and target
    parameters: Parameters
    fine_start: FloatArray | None  # (M, 4^k F, 3)
    # specs of source and target, one for each channel; empty for a channel given by values
    specs: tuple[tuple[str, ...], tuple[str, ...]]
    functions: FunctionTerm
    landmarks: Landmarks | None
    channels_given: bool  # whether the input was (V, C), not (V,)

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
            source, target = (_filled_in(mesh, each, mask > 0) for each in (source, target))
        unit = mesh.normalized()
        functions = FunctionTerm(unit, source, target, mask, weights, approximate=approximate)
        functions.check_sizes()
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
        """The source, (V, C), read-only."""
        return _read_only(self.functions.source.T)

    @property
    def target(self) -> FloatArray:
        """The target, (V, C), read-only."""
        return _read_only(self.functions.target.T)

    @cached_property
    def start(self) -> FloatArray | None:
        """The initial fields on the mesh itself, (M, F, 3), read-only; None for zero."""
        fine = self.fine_start
        return None if fine is None else _read_only(mean_of_children(fine, len(self.mesh.faces)))

    @property
    def mask(self) -> FloatArray | None:
        """Weight of the mismatch at each vertex, (V,); None if it is 1 everywhere."""
        mask = self.functions.mask
        return None if mask is None else _read_only(mask)

    @property
    def weights(self) -> FloatArray:
        """Weight of the mismatch of each channel, (C,)."""
        return _read_only(self.functions.weights)

    @property
    def is_of_landmarks(self) -> bool:
        """Whether only landmarks are matched."""
        return self.landmarks is not None and self.functions.is_constant

    @cached_property
    def divergence(self) -> float:
        """The weight of the divergence of a field relative to its curl.

        The weight is the parameter ``divergence``. If that is None, the weight is 1 for measured
        functions. For others it is `AREA_PRESERVING_DIVERGENCE`, so that areas change less. It is
        the same on coarser and finer meshes.
        """
        given = self.parameters.divergence
        if given is None:
            return 1.0 if is_measured(self.functions) else AREA_PRESERVING_DIVERGENCE
        return given

    def starting_from(self, start: ArrayLike | None) -> Problem:
        """Return a copy with another start, or without a start for None."""
        return self._with(fine_start=_checked_start(start, self.mesh))

    def with_parameters(self, parameters: Parameters) -> Problem:
        """Return a copy with other parameters."""
        other = self._with(parameters=parameters)
        other.__dict__.pop("divergence", None)
        return other

    def with_specs(self, f: Sequence[str], g: Sequence[str]) -> Problem:
        """Return a copy with the function specs of source and target, one for each channel.

        The spec of a channel that was given by values is empty.
        """
        count = len(self.functions.source)
        return self._with(specs=tuple(_specs(list(given), count) for given in (f, g)))

    def with_mask(self, mask: FloatArray) -> Problem:
        """Return a copy with another mask (V,) of source and target."""
        return self._with_functions(self.functions.with_mask(mask))

    def with_known_values(self, mask: FloatArray | None) -> Problem:
        """Return a copy with another mask (V,); the values of masked vertices do not change.

        All functions have to be known at masked vertices. The argument ``mask`` of `Problem` would
        extend them harmonically to these vertices.
        """
        term = self.functions
        return self._with_functions(term.with_values(term.mesh, term.source, term.target, mask))

    def _with_functions(self, functions: FunctionTerm) -> Problem:
        return self._with(terms=(functions, *self.terms[1:]), functions=functions)

    def subdivided(self) -> Problem:
        """Return the problem on the midpoint subdivision of its mesh; the result is cached.

        Specs are evaluated again, except those of files, vertex permutations and curvature. Such
        functions, and functions given as arrays, are interpolated. The mask at the midpoint of an
        edge is the smaller one of its ends, so masked values have no effect. A start on the mesh
        itself is made continuous and evaluated on the child faces.

        Raises
        ------
        AbfmError
            If faces are too small to subdivide, or if a data term does not support finer meshes.
        """
        return self._subdivided

    def refined(self, k: int) -> Problem:
        """Return the problem on the mesh subdivided k times."""
        return self.subdivided().refined(k - 1) if k else self

    @cached_property
    def _subdivided(self) -> Problem:
        mesh, fine, term = self.mesh, refined(self.mesh, 1), self.functions
        source, target = (
            np.stack([on_subdivision(mesh, *pair) for pair in zip(values, specs, strict=True)])
            for values, specs in zip((term.source, term.target), self.specs, strict=True)
        )
        mask = None if term.mask is None else mask_on_children(mesh, term.mask)
        if mask is not None:
            source, target = (extend_all(fine, each, mask > 0) for each in (source, target))
        unit = fine.normalized()
        functions = term.with_values(unit, source, target, mask)
        functions.function_size = term.function_size
        others = [term.restricted(_Finer(mesh, fine)) for term in self.terms[1:]]
        if None in others:
            raise ParameterError("a data term does not support finer meshes; use refine=0")
        start, landmarks = self.fine_start, self.landmarks
        if start is not None and start.shape[1] == len(mesh.faces):
            start = np.stack([field_on_children(mesh, field) for field in start])
        return self._with(
            mesh=fine,
            terms=(functions, *others),
            functions=functions,
            landmarks=landmarks and landmarks.subdivided(unit),
            fine_start=start,
            divergence=self.divergence,
        )

    def restricted(self, restriction: Restriction) -> Problem | None:
        """Return the problem on a coarser mesh, without a start.

        None if a data term is undefined there, for example if the mask is 0 everywhere.
        """
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
        """Hash of the content in hexadecimal digits, the same in every process."""
        digest = hashlib.sha256(b"abfm problem, format 1\n")
        arrays = self.arrays()
        for name in results.MESH_NAMES:  # the name and metadata of the mesh file
            arrays.pop(name, None)
        for piece in results.pieces(arrays):
            digest.update(piece)
        for term in self.terms[1:]:
            digest.update(f"{type(term).__qualname__}\n".encode())
        return digest.hexdigest()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the complete content as arrays, for files and for the digest."""
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

    def residual(self, advected: FloatArray, errors: FloatArray | None) -> float:
        of_functions = self.functions.residual(advected)
        return of_functions if errors is None else max(of_functions, residual_of_errors(errors))

    def spec_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the specs as arrays (C,) for files; an empty dictionary if there are none."""
        if not any(map(any, self.specs)):
            return {}
        return dict(zip(results.SPEC_ENTRIES, map(np.array, self.specs), strict=True))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles) atomically, or raise ResultError.

        Files cannot store additional data terms.
        """
        results.save_arrays(path, self.arrays(), results.PROBLEM)

    def __repr__(self) -> str:
        return f"Problem({self.mesh!r}, channels={len(self.functions.source)})"

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"a Problem is immutable; make a new one instead of setting {name}")

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling, without meshes of terms; `__setstate__` adds these."""
        names = ("mesh", "parameters", "fine_start", "channels_given", "specs", "landmarks")
        terms = [copy(term) for term in self.terms]
        for term in terms:
            term.__dict__.pop("mesh", None)
        return {name: self.__dict__[name] for name in names} | {"terms": terms}

    def __setstate__(self, state: dict[str, Any]) -> None:
        unit = state["mesh"].normalized()
        for term in state["terms"]:
            term.__dict__["mesh"] = unit
        if state["landmarks"] is not None:
            state["landmarks"].mesh = unit
        self.__dict__.update(state, terms=tuple(state["terms"]), functions=state["terms"][0])

    def _with(self, **changes: Any) -> Problem:
        other = copy(self)
        for cached in ("digest", "start", "_subdivided"):
            other.__dict__.pop(cached, None)
        other.__dict__.update(changes)
        return other


def load_problem(path: File) -> Problem:
    """Read a problem from a file of `abfm.Problem.save`; raise ResultError if that fails."""
    return results.loaded(path, results.PROBLEM, lambda it: problem_of(results.mesh_of(it), it))


def problem_of(mesh: TriangleMesh, arrays: Mapping[str, NDArray[Any]]) -> Problem:
    """Return the problem of stored arrays; unlike `Problem`, accept values that are too large."""
    parameters = Parameters.of(**from_json(str(arrays["parameters"])))
    source, target, weights = (arrays[name] for name in ("source", "target", "weights"))
    landmarks = [arrays[name] for name in results.LANDMARK_ENTRIES if name in arrays]
    unit, mask, is_approximate = mesh.normalized(), arrays.get("mask"), "approximate" in arrays
    functions = FunctionTerm(unit, source, target, mask, weights, approximate=is_approximate)
    if not landmarks:
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
        landmarks=_landmarks_of_file(mesh, landmarks),
    )


def check_fields(velocity: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    """Check that fields are finite and have ``shape`` (N, F, 3); return them.

    A single field may also have the shape (F, 3). ``name`` appears in error messages.
    """
    field = real_numbers(velocity, name, ParameterError)
    if field.shape == shape[1:] and shape[0] == 1:
        field = field[None]
    if field.shape != shape:
        raise ParameterError(f"{name} has shape {field.shape}; expected {shape}")
    if not np.isfinite(field).all():
        raise ParameterError(f"{name} has values that are not finite; expected numbers")
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
            "all weights are zero; give at least one channel a weight above 0, or give landmarks "
            "to match these alone"
        )


def _landmarks_of_file(mesh: TriangleMesh, arrays: list[NDArray[Any]]) -> Landmarks | None:
    if not arrays:
        return None
    if len(arrays) != len(results.LANDMARK_ENTRIES):
        names = ", ".join(results.LANDMARK_ENTRIES)
        raise ValueError(f"the file has {len(arrays)} of the arrays {names}; expected all or none")
    faces, barycentric, weights = arrays
    pair = tuple(SurfacePoints(mesh, faces[:, k], barycentric[:, k]) for k in range(2))
    return landmarks_of(mesh, pair, weights)


def mask_on_children(mesh: TriangleMesh, mask: FloatArray) -> FloatArray:
    """Return a mask (V,) on the subdivided mesh; a midpoint gets the smaller value of its edge."""
    return np.concatenate([mask, mask[mesh.edges].min(axis=1)])


@dataclass(frozen=True)
class _Finer:
    """The restriction of data terms from a mesh to its midpoint subdivision.

    The attribute ``coarse`` is the finer mesh, because the protocol `Restriction` requires this
    name.
    """

    mesh: TriangleMesh
    coarse: TriangleMesh

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        return np.moveaxis(interpolated(self.mesh, np.moveaxis(f, -1, 0)), 0, -1)


def _values(mesh: TriangleMesh, given: Any) -> FloatArray:
    if (texts := texts_of(given)) is None:
        return np.asarray(given)
    values = [function(mesh, text, allow_missing=True) for text in texts]
    return values[0] if isinstance(given, str) else np.stack(values, axis=1)


def _mask_of_known(
    mesh: TriangleMesh, functions: tuple[FloatArray, FloatArray], mask: FloatArray | None
) -> FloatArray | None:
    """Return a mask (V,), set to 0 where a function is NaN; None if no vertex is masked."""
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
        raise FunctionError(
            "source and target have no common vertex with a value (others are NaN or masked)"
        )
    count = np.count_nonzero(missing)
    text = f"{count:,} of {len(missing):,} vertices have no value (NaN) and are masked"
    warnings.warn(text, AbfmWarning, stacklevel=3)
    return found


def _filled_in(mesh: TriangleMesh, values: FloatArray, known: BoolArray) -> FloatArray:
    """Extend functions (V,) or (V, C) harmonically to vertices where ``known`` (V,) is False."""
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
        raise ParameterError(
            f"got {counted(len(known), 'spec')} for {counted(count, 'channel')}; give one for each "
            "channel, or '' for a channel without a spec"
        )
    texts = (str(parse(text)) if text else "" for text in known)
    # files store no other characters
    return tuple(text if text.isprintable() else "" for text in texts)


def _read_only(array: FloatArray) -> FloatArray:
    view = array.view()
    view.flags.writeable = False
    return view


def on_subdivision(mesh: TriangleMesh, values: FloatArray, spec: str = "") -> FloatArray:
    """Return the values of a function (V,) on the subdivided mesh, (V + E,), with E edges.

    If the spec defines the same function on the subdivided mesh, it is evaluated there. Otherwise,
    the values are interpolated.
    """
    fine = refined(mesh, 1)
    if spec and _is_meaningful(spec):
        try:
            evaluated = function(fine, spec)
        except AbfmError:
            return interpolated(mesh, values)
        difference = np.linalg.norm(evaluated[: len(values)] - values)
        if difference <= _DIFFERENCE_MAX * np.linalg.norm(values):
            return evaluated
    return interpolated(mesh, values)


def _is_meaningful(spec: str) -> bool:
    """Return whether a function spec defines the same function on a subdivided mesh.

    Files and permutations belong to one mesh, and curvature is 0 at the midpoints of flat edges.
    """
    try:
        parts = functions_in(parse(spec))
    except AbfmError:
        return False
    return not any(isinstance(part, ValuesFile | Permuted | Curvature) for part in parts)

"""A problem as one value: what is to be matched, with which parameters, from which start."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import MeshError, ParameterError, ResultError, brief, one_line
from abfm.io import results
from abfm.matching.terms.data_term import DataTerm, Restriction
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.parameters import Parameters
from abfm.reading import from_json
from abfm.types import FloatArray


class Problem:
    """Find v that minimises ``1/2 int ||v||_alpha^2 dt + 1/(2 sigma^2) ||f_tau - g||^2`` (Eq. 3).

    It never changes, is checked when it is made, and has its data terms on the mesh scaled to unit
    area, in whose units everything is solved.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) or (V, C) arrays
        Source and target, one or several channels.
    parameters : Parameters, optional
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative.
    weights : (C,) array, optional
        Weight of each channel's mismatch, not negative.
    start : (M, F, 3) or (F, 3) array, optional
        Fields to start from, such as an earlier ``match.velocity``, also one found for other
        functions or parameters; those of M segments are averaged over, or repeated in, the N of
        these parameters. Sigma is then not cooled again, which would lead away from a good start,
        unless the parameters have a reach and the start is far from the target. None for zero.
    terms : sequence of DataTerm
        What else is to be matched, on ``mesh.normalized()``.

    Raises
    ------
    AbfmError
        If the functions, parameters, mask, weights or start do not fit.

    Examples
    --------
    >>> import abfm
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("human_A.off"))
    >>> f, g = (abfm.function(mesh, f"gaussian:vertex={i},width=0.2") for i in (394, 14))
    >>> problem = abfm.Problem(mesh, f, g, abfm.Parameters(sigma=0.02))
    >>> abfm.match(problem).verdict.kind
    'matched'
    """

    mesh: TriangleMesh
    terms: tuple[DataTerm, ...]  # all of them: first that of source and target
    parameters: Parameters
    start: FloatArray | None
    functions: FunctionTerm
    channels_given: bool  # source and target came as (V, C); else as (V,)

    def __init__(
        self,
        mesh: TriangleMesh,
        f: ArrayLike,
        g: ArrayLike,
        parameters: Parameters | None = None,
        *,
        mask: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        start: ArrayLike | None = None,
        terms: Sequence[DataTerm] = (),
    ) -> None:
        if not isinstance(mesh, TriangleMesh):
            raise MeshError(f"mesh is {brief(mesh)}; expected a TriangleMesh, see abfm.load_mesh")
        if not isinstance(parameters, Parameters | None):
            raise ParameterError(
                f"parameters is {brief(parameters)}; expected abfm.Parameters(...)"
            )
        functions = FunctionTerm(mesh.normalized(), f, g, mask, weights)
        functions.refuse_extremes()
        self.__dict__.update(
            mesh=mesh,
            terms=(functions, *terms),
            parameters=parameters or Parameters(),
            start=_checked_start(start, mesh),
            functions=functions,
            channels_given=np.ndim(f) == 2,
        )

    @property
    def source(self) -> FloatArray:
        """The source, (V, C), which cannot be written to."""
        return _read_only(self.functions.source.T)

    @property
    def target(self) -> FloatArray:
        """The target, (V, C), which cannot be written to."""
        return _read_only(self.functions.target.T)

    @property
    def mask(self) -> FloatArray | None:
        """Weight of the mismatch at each vertex, (V,); None for 1 everywhere."""
        mask = self.functions.mask
        return None if mask is None else _read_only(mask)

    @property
    def weights(self) -> FloatArray:
        """Weight of each channel's mismatch, (C,)."""
        return _read_only(self.functions.weights)

    def starting_from(self, start: ArrayLike | None) -> Problem:
        """Return the same problem with another start."""
        return self._with(start=_checked_start(start, self.mesh))

    def with_parameters(self, parameters: Parameters) -> Problem:
        """Return the same problem with other parameters."""
        return self._with(parameters=parameters)

    def restricted(self, restriction: Restriction) -> Problem | None:
        """Return the problem on a coarser mesh, without a start; None if there is none."""
        terms = tuple(term.restricted(restriction) for term in self.terms)
        if None in terms:
            return None
        return self._with(mesh=restriction.coarse, terms=terms, functions=terms[0], start=None)

    @cached_property
    def digest(self) -> str:
        """Name of the problem by its content, in hexadecimal digits: the same in every process."""
        digest = hashlib.sha256(b"abfm problem, format 1\n")
        for name, value in sorted(self.arrays().items()):
            array = value.astype(value.dtype.newbyteorder("<"))
            digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
            digest.update(array.tobytes())
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
        if self.start is not None:
            parts["start"] = self.start
        return {name: np.asarray(part) for name, part in parts.items()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError."""
        results.save_arrays(path, self.arrays(), results.PROBLEM)

    def __repr__(self) -> str:
        return f"Problem({self.mesh!r}, channels={len(self.functions.source)})"

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"a Problem does not change: make a new one instead of setting {name}")

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs: the terms' mesh is made of the problem's there."""
        kept = ("mesh", "parameters", "start", "channels_given")
        terms = [copy(term) for term in self.terms]
        for term in terms:
            term.__dict__.pop("mesh", None)
        return {name: self.__dict__[name] for name in kept} | {"terms": terms}

    def __setstate__(self, state: dict[str, Any]) -> None:
        unit = state["mesh"].normalized()
        for term in state["terms"]:
            term.__dict__["mesh"] = unit
        self.__dict__.update(state, terms=tuple(state["terms"]), functions=state["terms"][0])

    def _with(self, **changes: Any) -> Problem:
        other = copy(self)
        other.__dict__.pop("digest", None)
        other.__dict__.update(changes)
        return other


def load_problem(path: str | os.PathLike[str]) -> Problem:
    """Read a file of `Problem.save`; ResultError if it is missing, damaged, or no problem."""
    arrays = results.load_arrays(path, results.PROBLEM)
    try:
        mesh = results.mesh_of({name: arrays.pop(name) for name in results.MESH_ENTRIES})
        parameters = Parameters.from_dict(from_json(str(arrays.pop("parameters"))))
        return problem_of(mesh, arrays, parameters)
    except Exception as error:  # what stands in for a text, a number or a list may do anything
        raise ResultError(f"{one_line(path)}: {one_line(error, 400)}; {results.MEND}") from error


def problem_of(
    mesh: TriangleMesh, arrays: Mapping[str, NDArray[Any]], parameters: Parameters
) -> Problem:
    """Return the problem of such arrays; functions may have values that are refused today."""
    source, target, weights = (arrays[name] for name in ("source", "target", "weights"))
    functions = FunctionTerm(mesh.normalized(), source, target, arrays.get("mask"), weights)
    zero = np.zeros(len(mesh.vertices))
    return Problem(mesh, zero, zero, parameters)._with(
        terms=(functions,),
        functions=functions,
        channels_given=bool(arrays["channels_given"]),
        start=_checked_start(arrays.get("start"), mesh),
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
    count = max(len(fields), 1) if fields.ndim == 3 else 1
    return _read_only(check_fields(fields, (count, len(mesh.faces), 3), "start").copy())


def _read_only(array: FloatArray) -> FloatArray:
    view = array.view()
    view.flags.writeable = False
    return view

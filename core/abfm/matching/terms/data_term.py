"""The contract of a data term: what the flow is to carry, and what is left of it to match."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray


class Restriction(Protocol):
    """From a mesh to a coarser one of the same surface, in the same units, or a finer one."""

    @property
    def coarse(self) -> TriangleMesh: ...

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        """Average functions (..., V) on the coarser mesh, or interpolate them on the finer one."""
        ...


class Measure(Protocol):
    """The norm of what is left of the functions (C, V) that a term wants carried."""

    def value_and_residual(self, carried: FloatArray, sigma: float) -> tuple[float, FloatArray]:
        """Return the energy, and its derivative (C, V)."""
        ...


class DataTerm(Protocol):
    """What is to be matched, on a mesh of unit area; immutable.

    Its ``word`` is what displays call its share of the energy.
    """

    word: str

    @property
    def carried(self) -> FloatArray:
        """Functions (C, V) that the flow is to carry."""
        ...

    def measure(self, parameters: Parameters, reach: float) -> Measure:
        """Make the norm of what is left; a reach above 0 is felt so far, in sqrt(area)."""
        ...

    def residual(self, carried: FloatArray) -> float:
        """Return the relative residual, 0 for a match and about 1 before anything moved."""
        ...

    def restricted(self, restriction: Restriction) -> DataTerm | None:
        """Return the term on that mesh scaled to unit area; None if it has no place there."""
        ...

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return everything that it is made of but the mesh, for files and digests."""
        ...


class DataTerms:
    """A sum of data terms on one mesh, whose functions (C, V) are carried together."""

    def __init__(self, terms: Sequence[DataTerm]) -> None:
        self.terms = tuple(terms)
        self.carried: FloatArray = np.concatenate([term.carried for term in terms])

    def residual(self, carried: FloatArray) -> float:
        """Return the root of the sum of the terms' squares."""
        pairs = zip(self.terms, self.split(carried), strict=True)
        return math.hypot(*(term.residual(own) for term, own in pairs))

    def measure(self, parameters: Parameters, reach: float) -> Sum:
        """Make the sum of the terms' norms."""
        return Sum(self.split, [term.measure(parameters, reach) for term in self.terms])

    def split(self, functions: FloatArray) -> list[FloatArray]:
        """Return each term's own of functions (C, V)."""
        ends = np.cumsum([len(term.carried) for term in self.terms])
        return np.split(functions, ends[:-1])


@dataclass(frozen=True, eq=False)
class Sum:
    """The norms of several terms."""

    split: Callable[[FloatArray], list[FloatArray]]
    measures: Sequence[Measure]

    def shares_and_residual(
        self, carried: FloatArray, sigma: float
    ) -> tuple[tuple[float, ...], FloatArray]:
        """Return each term's energy, and the derivative (C, V) of their sum."""
        parts = [
            measure.value_and_residual(own, sigma)
            for measure, own in zip(self.measures, self.split(carried), strict=True)
        ]
        shares, residuals = zip(*parts, strict=True)
        return shares, np.concatenate(residuals)

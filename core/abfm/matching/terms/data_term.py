"""The protocol of data terms, and sums of several terms."""

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
    """The transfer of functions to ``coarse``, another mesh of the same surface and unit."""

    @property
    def coarse(self) -> TriangleMesh: ...

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        """Average functions (..., V) on a coarser mesh, or interpolate them on a finer one."""
        ...


class Measure(Protocol):
    """The energy of a data term in one norm, as a function of the advected sources (C, V)."""

    def value_and_derivative(self, advected: FloatArray, sigma: float) -> tuple[float, FloatArray]:
        """Return the energy and its derivative (C, V)."""
        ...


class DataTerm(Protocol):
    """A term of the energy that compares advected functions with targets.

    A data term refers to a mesh of unit area and is immutable. Plots of the energy show its
    ``name``.
    """

    name: str

    @property
    def sources(self) -> FloatArray: ...

    def measure(self, parameters: Parameters, reach: float) -> Measure:
        """Return the energy with a norm that compares functions over a distance ``reach``.

        The distance is in sqrt(area). With reach 0, functions are compared point by point.
        """
        ...

    def residual(self, advected: FloatArray) -> float:
        """Return the relative residual: 0 for a match, and about 1 without motion."""
        ...

    def restricted(self, restriction: Restriction) -> DataTerm | None:
        """Return the term on the mesh of a restriction, scaled to unit area.

        None if the term is undefined there.
        """
        ...

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return the complete content except the mesh, for files and digests."""
        ...


class DataTerms:
    """A sum of data terms on one mesh, whose sources (C, V) are advected together."""

    def __init__(self, terms: Sequence[DataTerm]) -> None:
        self.terms = tuple(terms)
        self.sources: FloatArray = np.concatenate([term.sources for term in terms])

    def residual(self, advected: FloatArray) -> float:
        """Return the square root of the sum of the squared residuals of all terms."""
        pairs = zip(self.terms, self.split(advected), strict=True)
        return math.hypot(*(term.residual(part) for term, part in pairs))

    def measure(self, parameters: Parameters, reach: float) -> Sum:
        """Return the sum of the energies, with a norm that compares over a distance ``reach``."""
        return Sum(self.split, [term.measure(parameters, reach) for term in self.terms])

    def split(self, functions: FloatArray) -> list[FloatArray]:
        """Split functions (C, V) of all terms into those of each term."""
        ends = np.cumsum([len(term.sources) for term in self.terms])
        return np.split(functions, ends[:-1])


@dataclass(frozen=True, eq=False)
class Sum:
    """The energies of several terms, and their sum."""

    split: Callable[[FloatArray], list[FloatArray]]
    measures: Sequence[Measure]

    def energies_and_derivative(
        self, advected: FloatArray, sigma: float
    ) -> tuple[tuple[float, ...], FloatArray]:
        pairs = zip(self.measures, self.split(advected), strict=True)
        parts = [measure.value_and_derivative(part, sigma) for measure, part in pairs]
        energies, derivatives = zip(*parts, strict=True)
        return energies, np.concatenate(derivatives)

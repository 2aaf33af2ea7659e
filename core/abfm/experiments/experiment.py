"""What an experiment is: a set-up ready to run, and what running it finds."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from abfm.errors import MeshError
from abfm.experiments import TITLES
from abfm.experiments.sheet import Sheet
from abfm.flow.flow import Flow
from abfm.functions import function
from abfm.matching.match import match
from abfm.matching.result import Match
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray

Report = Callable[[str, float], None]
"""Told what is being done, in a few words, and which share of the experiment is behind it."""


@dataclass(frozen=True)
class Measure:
    """A measured number, whose `name` says its unit; what the paper claims about it, and whether it bears that out.

    The value must not exceed the `bound`, if there is one.

    Raises
    ------
    MeshError
        If the value is not finite: it could not be measured on this mesh.
    """

    name: str
    value: float
    claim: str = ""
    reproduces: bool | None = None
    bound: float | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise MeshError(f"'{self.name}' came out as {self.value}: the mesh is too coarse or degenerate for it")

    @property
    def passes(self) -> bool | None:
        """Whether the value keeps the bound; None without one."""
        return None if self.bound is None else bool(self.value <= self.bound)

    def to_dict(self) -> dict[str, Any]:
        """As it stands in a figure's JSON."""
        return {
            "name": self.name,
            "value": float(self.value),
            "bound": None if self.bound is None else float(self.bound),
            "pass": self.passes,
            "claim": self.claim,
            "reproduces": None if self.reproduces is None else bool(self.reproduces),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """A problem ready to run, in the app as well, on a mesh that is called `name`.

    Sources and targets are specs of `abfm.functions`, one per channel; `values` (V,) are functions that no text
    describes, by the spec of a file, ``file:name.npy``, that need not exist. A flow is what the experiment is about,
    where it is given and not sought.
    """

    mesh: TriangleMesh
    name: str
    sources: tuple[str, ...]
    targets: tuple[str, ...]
    values: Mapping[str, FloatArray] = field(default_factory=dict)
    parameters: Parameters
    flow: Flow | None = None

    @property
    def source(self) -> FloatArray:
        """The sources' values, (V, C)."""
        return self._evaluate(self.sources)

    @property
    def target(self) -> FloatArray:
        """The targets' values, (V, C)."""
        return self._evaluate(self.targets)

    @property
    def where(self) -> str:
        """The mesh in words."""
        return f"{self.name}, {len(self.mesh.vertices):,} vertices"

    def _evaluate(self, specs: tuple[str, ...]) -> FloatArray:
        known = self.values
        return np.stack([known[spec] if spec in known else function(self.mesh, spec) for spec in specs], axis=1)


@dataclass(frozen=True, eq=False)
class Findings:
    """What running an experiment found.

    Attributes
    ----------
    measures : tuple of Measure
    sheet : Sheet
        The figure, to be drawn.
    setting : str
        What was run: mesh, functions, parameters, in a sentence or two.
    """

    measures: Sequence[Measure]
    sheet: Sheet
    setting: str


def solved(
    setup: Setup,
    report: Report,
    text: str,
    shares: tuple[float, float] = (0.0, 0.95),
    source: FloatArray | None = None,
    target: FloatArray | None = None,
) -> Match:
    """Match the set-up's functions, or others (V, C); `report` hears of it from one share to another."""
    limit, (begin, end) = max(setup.parameters.iterations, 1), shares
    return match(
        setup.mesh,
        setup.source if source is None else source,
        setup.target if target is None else target,
        setup.parameters,
        on_iteration=lambda now: report(text, begin + (end - begin) * now.iteration / limit),
    )


def affordable_iterations(mesh: TriangleMesh, most: int) -> int:
    """60 to ``most``, in about half a minute with three functions: for want of time, as fine meshes need more."""
    return min(max(1_230_000 // len(mesh.vertices), 60), most)


S = TypeVar("S", bound=Setup)


@dataclass(frozen=True, eq=False)
class Experiment(Generic[S]):
    """A figure of the paper as a set-up that can be run again.

    Attributes
    ----------
    number : int
        The figure's number in the paper.
    claim : str
        What the paper shows with it.
    set_up : callable
        Given a mesh, or None for the experiment's own, and whether to be small (for tests: a few seconds, coarse
        meshes), makes the set-up; `MeshError` says why a mesh will not do.
    run : callable
        Runs a set-up. The same set-up gives the same findings.
    """

    number: int
    claim: str
    set_up: Callable[[TriangleMesh | None, bool], S]
    run: Callable[[S, Report], Findings]

    @property
    def title(self) -> str:
        """A few words for a menu."""
        return TITLES[self.number]

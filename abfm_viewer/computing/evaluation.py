"""Values of functions on the mesh, computed off the frame loop and kept."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np

import abfm
from abfm import AbfmError, FunctionError, TriangleMesh
from abfm.errors import brief
from abfm.types import FloatArray
from abfm.workers.progress import Step, step
from abfm.workers.worker import Worker, stateless
from abfm_viewer.computing.background import Latest, error_line
from abfm_viewer.computing.defaults import default_functions
from abfm_viewer.document.document import Side

OWN_PROCESS_FROM = 20_000
"""Vertices from which on a process computes: below, it is quick, and starting a process is not.

What is behind geodesics and eigenfunctions keeps the interpreter to itself: seventeen seconds at
160,000 vertices.
"""
_EXACT_VERTICES_MIN = 1_500  # the same for exact geodesic distances, 1 s at 6,000 vertices
_VALUES_KEPT = 64
# of a function's largest value: the screen has single precision
_SIZE_MIN = 1e-30
_SIZE_MAX = 1e30

Result = TypeVar("Result")
Evaluated = dict[str, FloatArray | str]
"""Values (V,) of specs, or in a line why there are none."""


class Functions:
    """Evaluates specs on one mesh, term by term: dragging one of several Gaussians costs only one.

    Of terms from a project file the values (V,) are `known`: what came from other files needs these
    files no longer. If `at_once`, `ask` waits for what it asks for. Once it `has_computed`
    something, there may be a thread and a process.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        known: Mapping[str, FloatArray] | None = None,
        at_once: bool = False,
    ) -> None:
        self.mesh = mesh
        self.known = dict(known or {})
        self.has_computed = False
        self._worker: Worker[None] | None = None
        self._is_large = len(mesh.vertices) >= OWN_PROCESS_FROM
        if self._is_large or len(mesh.vertices) >= _EXACT_VERTICES_MIN:
            ended = "the process that computes functions has ended; try again"
            self._worker = Worker(stateless, ended)
        self._at_once = at_once
        self._cache: OrderedDict[str, FloatArray] = OrderedDict()
        self._lock = threading.RLock()
        self._latest: Latest[Evaluated] = Latest(at_once)
        self._asked: tuple[str, ...] = ()
        self._waits = False  # whether what was asked for last was not there

    @property
    def busy(self) -> bool:
        return self._waits and self._latest.busy

    @property
    def step(self) -> Step | None:
        return self._latest.step if self.busy else None

    def at_rest(self, is_kept: Callable[[str], bool]) -> Functions:
        """Others, without thread and process, with the values asked for last and those kept."""
        cached = self._cache.copy()  # without the lock, as another thread may evaluate for long
        known = self.known | {spec: values for spec, values in cached.items() if is_kept(spec)}
        others = Functions(self.mesh, known, self._at_once)
        others._cache.update((spec, cached[spec]) for spec in self._asked if spec in cached)
        return others

    def defaults(self) -> tuple[str, str]:
        return self._compute(default_functions)

    def ask(self, specs: tuple[str, ...]) -> Evaluated | None:
        """Values of all specs; None while they are being computed."""
        cached: Evaluated = {}
        for spec in specs:
            if (values := self._cache.get(spec)) is not None:
                cached[spec] = values
        self._asked, self._waits = specs, len(cached) < len(specs)
        return self._latest.ask(specs, lambda: self._all(specs)) if self._waits else cached

    def evaluate(self, spec: str) -> FloatArray:
        """Values (V,) of one spec, computed now; errors as of `abfm.function`, and of a worker."""
        with self._lock:
            if spec in self._cache:
                self._cache.move_to_end(spec)
                return self._cache[spec]
            self.has_computed = True
            if spec in self.known:
                values = self.known[spec]
            else:
                tree = abfm.functions.parse(spec)
                if str(tree) != spec:  # values are kept by the one text form of a function
                    return self.evaluate(str(tree))
                if isinstance(tree, abfm.functions.Sum):
                    values = np.sum([self.evaluate(str(term)) for term in tree.terms], axis=0)
                else:
                    values = self._compute(_values, spec)
            largest = float(np.nanmax(np.abs(values)))
            if largest > _SIZE_MAX or 0 < largest < _SIZE_MIN:
                raise FunctionError(
                    f"{brief(spec)} has values up to {largest:.3g}; {_SIZE_MIN:g} to {_SIZE_MAX:g} "
                    "can be shown: scale it"
                )
            values.flags.writeable = False
            self._cache[spec] = values
            if len(self._cache) > _VALUES_KEPT:
                self._cache.popitem(last=False)
            return values

    def let_go(self) -> None:
        """Take no more requests; thread and process end when nobody evaluates with them."""
        self._latest.retire()

    def retire(self) -> None:
        """Take no more requests, and end the process at once: who waits for its answer is told."""
        self.let_go()
        if self._worker:
            self._worker.close()

    def _all(self, specs: tuple[str, ...]) -> Evaluated:
        found: Evaluated = {}
        for spec in specs:
            try:
                found[spec] = self.evaluate(spec)
            except (AbfmError, MemoryError) as error:
                found[spec] = error_line(error)
        return found

    def _compute(self, function: Callable[..., Result], *given: object) -> Result:
        is_exact = any("geodesic:" in str(each) for each in given)
        if self._worker is None or not (self._is_large or is_exact):
            return function(self.mesh, *given)
        with step("in a subprocess"):  # which takes seconds to start
            return self._worker.call(_apart, function, self.mesh, *given).result()


def _values(mesh: TriangleMesh, spec: str) -> FloatArray:
    """Return values (V,) of a spec, NaN where a file has none."""
    return abfm.functions.function(mesh, spec, may_be_unknown=True)


class Evaluators(NamedTuple):
    """What evaluates a document's functions: on the source's surface, and on the target's, which
    may be the same.
    """

    source: Functions
    target: Functions

    def evaluate(self, spec: str, side: Side = "target") -> FloatArray:
        return (self.source if side == "source" else self.target).evaluate(spec)


def _apart(_: None, function: Callable[..., Result], *given: object) -> Result:
    return function(*given)

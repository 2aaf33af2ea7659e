"""Evaluation of functions, given by texts such as ``eigenfunction:3``, in the background."""

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
from abfm.workers.worker import Worker, no_state
from abfm_viewer.computing.background import Latest, error_line
from abfm_viewer.computing.defaults import default_functions
from abfm_viewer.document.document import Side

SUBPROCESS_VERTICES_MIN = 20_000
"""Number of vertices from which a subprocess evaluates functions.

Smaller meshes take less time than the start of a process. On larger ones, geodesics and
eigenfunctions block all Python threads, for 17 s at 160,000 vertices.
"""
_EXACT_VERTICES_MIN = 1_500  # limit for geodesic distances, which take 1 s at 6,000 vertices
_CACHE_SIZE = 64  # number of functions
# limits of the largest absolute value of a function, as graphics have single precision
_SIZE_MIN = 1e-30
_SIZE_MAX = 1e30

Result = TypeVar("Result")
Evaluated = dict[str, FloatArray | str]  # values (V,) by spec, or an error message in one line


class Functions:
    """Evaluates specs (texts of functions) on one mesh, and caches the values of their terms.

    When the user drags one of several Gaussians, only that one is evaluated again. With
    ``at_once``, `request` computes in the caller's thread. ``known`` are values (V,) by spec, from
    a project file.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        known: Mapping[str, FloatArray] | None = None,
        at_once: bool = False,
    ) -> None:
        self.mesh = mesh
        # values (V,) by term, from a project file, which make the files of functions unnecessary
        self.known = dict(known or {})
        self.has_computed = False  # whether a thread and a subprocess may exist
        self._worker: Worker[None] | None = None
        self._is_large = len(mesh.vertices) >= SUBPROCESS_VERTICES_MIN
        if self._is_large or len(mesh.vertices) >= _EXACT_VERTICES_MIN:
            ended = "the process that computes functions has ended; try again"
            self._worker = Worker(no_state, ended)
        self._at_once = at_once
        self._cache: OrderedDict[str, FloatArray] = OrderedDict(
            (spec, values)
            for spec, values in self.known.items()
            if np.isfinite(values).any() and _can_be_shown(float(np.nanmax(np.abs(values))))
        )
        self._lock = threading.RLock()
        self._latest: Latest[Evaluated] = Latest(at_once)
        self._requested: tuple[str, ...] = ()
        self._waits = False  # whether the cache lacked values of the last request

    @property
    def busy(self) -> bool:
        return self._waits and self._latest.busy

    @property
    def step(self) -> Step | None:
        return self._latest.overall.step if self.busy else None

    def without_process(self, keeps: Callable[[str], bool]) -> Functions:
        """Return a copy without thread and subprocess, which retains some of the values.

        These are the known values, those of the latest request, and those of specs for which
        ``keeps`` is true.
        """
        cached = self._cache.copy()  # without the lock, which another thread may hold for long
        known = self.known | {spec: values for spec, values in cached.items() if keeps(spec)}
        others = Functions(self.mesh, known, self._at_once)
        others._cache.update((spec, cached[spec]) for spec in self._requested if spec in cached)
        return others

    def defaults(self) -> tuple[str, str]:
        return self._compute(default_functions)

    def request(self, specs: tuple[str, ...]) -> Evaluated | None:
        """Request the values of specs; return values or errors by spec, None until computed."""
        cached: Evaluated = {}
        for spec in specs:
            if (values := self._cache.get(spec)) is not None:
                cached[spec] = values
        self._requested, self._waits = specs, len(cached) < len(specs)
        return self._latest.request(specs, lambda: self._all(specs)) if self._waits else cached

    def evaluate(self, spec: str) -> FloatArray:
        """Return the values (V,) of a spec, computed now if necessary.

        Errors are those of `abfm.function`; if the subprocess ends, a `WorkerEndedError` is raised.
        """
        with self._lock:
            if spec in self._cache:
                self._cache.move_to_end(spec)
                return self._cache[spec]
            self.has_computed = True
            if spec in self.known:
                values = self.known[spec]
            else:
                tree = abfm.functions.parse(spec)
                if str(tree) != spec:  # the key of the cache is the canonical text of a function
                    return self.evaluate(str(tree))
                if isinstance(tree, abfm.functions.Sum):
                    values = np.sum([self.evaluate(str(term)) for term in tree.terms], axis=0)
                else:
                    values = self._compute(_values, spec)
            largest = float(np.nanmax(np.abs(values)))
            if not _can_be_shown(largest):
                raise FunctionError(
                    f"{brief(spec)} has values up to {largest:.3g}, but the window can show only "
                    f"{_SIZE_MIN:g} to {_SIZE_MAX:g}. Scale the function"
                )
            values.flags.writeable = False
            self._cache[spec] = values
            if len(self._cache) > _CACHE_SIZE:
                self._cache.popitem(last=False)
            return values

    def stop_requests(self) -> None:
        """Accept no more requests; running evaluations end normally, and then their subprocess."""
        self._latest.retire()

    def retire(self) -> None:
        """Accept no more requests and end the subprocess; running evaluations raise an error."""
        self.stop_requests()
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
        with step("in a subprocess"):  # it takes seconds to start
            return self._worker.call(_in_subprocess, function, self.mesh, *given).result()


def _can_be_shown(largest: float) -> bool:
    return largest == 0 or _SIZE_MIN <= largest <= _SIZE_MAX


def _values(mesh: TriangleMesh, spec: str) -> FloatArray:
    """Return the values (V,) of a spec; NaN where a file has no value."""
    return abfm.functions.function(mesh, spec, allow_missing=True)


class Evaluators(NamedTuple):
    """Evaluators for the surfaces of source and target, or the same one for a single surface."""

    source: Functions
    target: Functions

    def evaluate(self, spec: str, side: Side = "target") -> FloatArray:
        return (self.source if side == "source" else self.target).evaluate(spec)


def _in_subprocess(_: None, function: Callable[..., Result], *given: object) -> Result:
    return function(*given)

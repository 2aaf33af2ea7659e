"""Values of functions on the mesh, computed off the frame loop and kept."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

import abfm
from abfm import AbfmError, FunctionError, TriangleMesh
from abfm.errors import brief
from abfm.types import FloatArray
from abfm.workers.progress import Step
from abfm_viewer.computing.background import Latest, error_line
from abfm_viewer.computing.evaluator import Evaluator

_KEPT = 64
_LEAST, _LARGEST = 1e-30, 1e30  # of a function's largest value: the screen has single precision


@dataclass(frozen=True)
class Evaluated:
    """Values (V,) of the specs that could be evaluated, and why the others could not."""

    values: dict[str, FloatArray] = field(default_factory=dict)
    errors: dict[str, str] = field(default_factory=dict)


class Functions:
    """Evaluates specs on one mesh, term by term, so that dragging one of several Gaussians costs
    one Gaussian.

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
        self.evaluator = Evaluator(mesh)
        self._at_once = at_once
        self._cache: OrderedDict[str, FloatArray] = OrderedDict()
        self._lock = threading.RLock()
        self._latest: Latest[Evaluated] = Latest(at_once)
        self._asked: tuple[str, ...] = ()
        self._waits = False  # whether what was asked for last was not there
        self.has_computed = False

    @property
    def busy(self) -> bool:
        return self._waits and self._latest.busy

    def at_rest(self, is_kept: Callable[[str], bool]) -> Functions:
        """Others, without a thread and a process, with the values that were asked for last and
        those that are kept.
        """
        cached = self._cache.copy()  # without the lock, as another thread may evaluate for long
        known = self.known | {spec: values for spec, values in cached.items() if is_kept(spec)}
        others = Functions(self.mesh, known, self._at_once)
        others._cache.update((spec, cached[spec]) for spec in self._asked if spec in cached)
        return others

    @property
    def step(self) -> Step | None:
        """What is being done for what was asked for, if it tells."""
        return self._latest.step if self.busy else None

    def ask(self, specs: tuple[str, ...]) -> Evaluated | None:
        """Values of all specs; None while they are being computed."""
        cached = {spec: values for spec in specs if (values := self._cache.get(spec)) is not None}
        self._asked, self._waits = specs, len(cached) < len(specs)
        if not self._waits:
            return Evaluated(cached)
        return self._latest.ask(specs, lambda: self._evaluate_all(specs))

    def evaluate(self, spec: str) -> FloatArray:
        """Values (V,) of one spec, computed now; FunctionError as `abfm.function` raises it."""
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
                    values = self.evaluator.values(spec)
            _check_size(brief(spec), values)
            values.flags.writeable = False
            self._cache[spec] = values
            if len(self._cache) > _KEPT:
                self._cache.popitem(last=False)
            return values

    def close(self) -> None:
        """Compute nothing more; what is under way is waited for, but not for long."""
        self.retire()
        self._latest.close()

    def retire(self) -> None:
        """Compute nothing more, and do not wait for what is under way; its process ends."""
        self._latest.retire()
        self.evaluator.close()

    def let_go(self) -> None:
        """Take no more requests; the thread and the process end when nobody evaluates with them
        any more.
        """
        self._latest.retire()

    def _evaluate_all(self, specs: tuple[str, ...]) -> Evaluated:
        found = Evaluated()
        for spec in specs:
            try:
                found.values[spec] = self.evaluate(spec)
            except (AbfmError, MemoryError) as error:
                found.errors[spec] = error_line(error)
        return found


def _check_size(name: str, values: FloatArray) -> None:
    largest = float(np.abs(values).max())
    if largest > _LARGEST or 0 < largest < _LEAST:
        raise FunctionError(
            f"{name} has values up to {largest:.3g}; {_LEAST:g} to {_LARGEST:g} can be shown: "
            "scale it"
        )

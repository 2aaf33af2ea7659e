"""Values of the functions that are compared in the documents of a session.

Only meshes of the current document or of a run have a thread and a subprocess for evaluation.
"""

import time as clock
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import abfm
from abfm import AbfmError, TriangleMesh
from abfm.display import BEST_VIEW
from abfm.types import FloatArray
from abfm_viewer.computing.background import Memo
from abfm_viewer.computing.evaluation import Evaluated, Evaluators, Functions
from abfm_viewer.document.document import SIDES, Document, Function, Side
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.documents import Opened
from abfm_viewer.files.project import terms_from_files


class DocumentFunctions:
    """Evaluates and stores the functions of all documents in the history of a session."""

    def __init__(self, at_once: bool) -> None:
        # time (`time.perf_counter`) since which the document has waited for its first functions;
        # None if it has functions
        self.waiting_since: float | None = None
        self._at_once = at_once
        self._by_mesh: dict[TriangleMesh, Functions] = {}
        self._evaluated: dict[Functions, Evaluated] = {}
        self._period = Memo["float | None"]()

    def of(self, mesh: TriangleMesh) -> Functions:
        if mesh not in self._by_mesh:
            self._by_mesh[mesh] = Functions(mesh, at_once=self._at_once)
        return self._by_mesh[mesh]

    def of_document(self, document: Document) -> Evaluators:
        return Evaluators(*(self.of(document.surface(side).mesh) for side in SIDES))

    def add(self, mesh: TriangleMesh, known: Mapping[str, FloatArray]) -> None:
        if mesh in self._by_mesh:
            self._by_mesh[mesh].stop_requests()
        self._by_mesh[mesh] = Functions(mesh, known, self._at_once)

    def update(self, document: Document) -> None:
        """Request the document's functions and collect their values; called before drawing."""
        before, self._evaluated = self._evaluated, {}
        for surface in document.surfaces:
            evaluating = self.of(surface.mesh)
            on_mesh = (one for one in document.functions if one.surface.mesh is surface.mesh)
            specs = tuple(one.spec for one in on_mesh)
            found = evaluating.request(specs) if specs else None
            self._evaluated[evaluating] = found or before.get(evaluating, {})
        has_none = not any(self._evaluated.values())
        self.waiting_since = (self.waiting_since or clock.perf_counter()) if has_none else None

    def _values_or_error(self, function: Function) -> FloatArray | str:
        """Return the values (V,) of a function, or a message; "" while they are computed."""
        return self._evaluated.get(self.of(function.surface.mesh), {}).get(function.spec, "")

    def values(self, function: Function) -> FloatArray | None:
        """Return the values (V,) of a function; None while they are computed, or if this failed."""
        found = self._values_or_error(function)
        return None if isinstance(found, str) else found

    def period(self, document: MatchDocument) -> float | None:
        """Return the period of the active channel's source if its values are phases, or None."""
        if document.active is None:
            return None
        function = document.function("source", document.active)
        if (values := self.values(function)) is None:
            return None
        mesh = function.surface.mesh
        find = partial(abfm.functions.wrapped_period, mesh, values)
        return self._period.get((mesh, values), find)

    def error(self, function: Function) -> str:
        found = self._values_or_error(function)
        return found if isinstance(found, str) else ""

    def release_unused(
        self, in_use: Collection[TriangleMesh], in_history: Collection[TriangleMesh]
    ) -> None:
        """Free the memory of meshes that are not ``in_use``.

        Meshes that are not ``in_history`` either are forgotten. For the other unused meshes,
        computed values are dropped. Their values from files are kept, because the files may have
        changed. Running evaluations end normally, and then their subprocess ends.
        """
        for mesh, functions in list(self._by_mesh.items()):
            if mesh in in_use:
                continue
            mesh.cache.clear()  # including results of computations that ended later
            if mesh not in in_history:
                del self._by_mesh[mesh]
            elif functions.has_computed:
                self._by_mesh[mesh] = functions.without_process(_is_from_file)
            else:
                continue
            functions.stop_requests()

    def close(self) -> None:
        for functions in self._by_mesh.values():
            functions.retire()


def with_values(document: Document, known: dict[str, FloatArray]) -> Opened:
    """Return a document with the values of its shown functions and with its fronts.

    The first picture of such a document is complete. Functions that cannot be evaluated are left
    out, because the window shows why.
    """
    meshes = {document.surface(side).mesh: side for side in SIDES}
    evaluators = {
        mesh: Functions(mesh, document.values_on(side, known)) for mesh, side in meshes.items()
    }
    values: dict[Side, FloatArray] = {}
    for side in SIDES if document.active else ():
        spec = document.active.spec(side) if document.active else ""
        with suppress(AbfmError, MemoryError):
            values[side] = evaluators[document.surface(side).mesh].evaluate(spec)
            known = known | {document.values_key(side, spec): values[side]}
    for evaluator in evaluators.values():
        evaluator.retire()
    last = document.surface()
    if last.front is None and len(values) == len(SIDES):
        functions = [values[side] for side in SIDES if document.surface(side) is last]
        seen = document.facing(BEST_VIEW, *functions)
        document = replace(document, surfaces=seen.surfaces)
    return document, known


def _is_from_file(term: str) -> bool:
    with suppress(AbfmError):
        return term in terms_from_files(term)
    return False


def known_values(document: Document, functions: Evaluators) -> dict[str, FloatArray]:
    """Return the values (V,) of a document's functions that are read from files, for a project.

    They are stored under `Document.values_key`. Functions that cannot be evaluated are left out.
    """
    known = {}
    given: list[tuple[Side, str]] = [("target", document.mask)] if document.mask else []
    given += [(side, channel.spec(side)) for channel in document.channels for side in SIDES]
    terms = {(side, term) for side, spec in given for term in terms_from_files(spec)}
    for side, term in terms:
        with suppress(AbfmError):  # functions that cannot be evaluated have no values
            known[document.values_key(side, term)] = functions.evaluate(term, side)
    return known

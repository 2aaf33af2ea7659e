"""Values of a session's functions; only meshes at work have a thread and a process for them."""

from __future__ import annotations

import time as clock
from collections.abc import Collection, Mapping
from contextlib import suppress
from functools import partial

import abfm
from abfm import AbfmError, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.background import Memo
from abfm_viewer.computing.evaluation import Evaluated, Evaluators, Functions
from abfm_viewer.document.document import SIDES, Document, Function, Side
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.project import terms_from_files


class DocumentFunctions:
    """Functions of the documents that a session may return to.

    `bare_since` is the time, by `time.perf_counter`, from which on the present document has waited
    for its first functions; None if it has some.
    """

    def __init__(self, at_once: bool) -> None:
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
        """Begin with a mesh that was opened, and known values (V,) of functions from files."""
        if mesh in self._by_mesh:
            self._by_mesh[mesh].let_go()
        self._by_mesh[mesh] = Functions(mesh, known, self._at_once)

    def update(self, document: Document) -> None:
        """Evaluate what the document asks for, or take in what was: call once per frame."""
        before, self._evaluated = self._evaluated, {}
        for surface in document.surfaces:
            evaluating = self.of(surface.mesh)
            own = (one for one in document.functions if one.surface.mesh is surface.mesh)
            specs = tuple(one.spec for one in own)
            found = evaluating.ask(specs) if specs else None
            self._evaluated[evaluating] = found or before.get(evaluating, {})
        is_bare = not any(self._evaluated.values())
        self.waiting_since = (self.waiting_since or clock.perf_counter()) if is_bare else None

    def _found(self, function: Function) -> FloatArray | str:
        """Values (V,), or why there are none: nothing if they will come."""
        return self._evaluated.get(self.of(function.surface.mesh), {}).get(function.spec, "")

    def values(self, function: Function) -> FloatArray | None:
        """Values (V,); None before they were evaluated, or where they cannot be."""
        found = self._found(function)
        return None if isinstance(found, str) else found

    def period(self, document: MatchDocument) -> float | None:
        """Return the period of the active channel's source if its values jump by it, or None."""
        if document.active is None:
            return None
        function = document.function("source", document.active)
        if (values := self.values(function)) is None:
            return None
        mesh = function.surface.mesh
        find = partial(abfm.functions.wrapped_period, mesh, values)
        return self._period.get((mesh, values), find)

    def error(self, function: Function) -> str:
        found = self._found(function)
        return found if isinstance(found, str) else ""

    def keep(self, at_work: Collection[TriangleMesh], in_reach: Collection[TriangleMesh]) -> None:
        """Let go of meshes out of reach, and of others what was computed but is not shown there.

        What came from files stays, as these may have changed since. Who is still evaluating goes on
        with what there was, and the process ends with that.
        """
        for mesh, functions in list(self._by_mesh.items()):
            if mesh in at_work:
                continue
            mesh.cache.clear()  # also of what was still being computed when it was left
            if mesh not in in_reach:
                del self._by_mesh[mesh]
            elif functions.has_computed:
                self._by_mesh[mesh] = functions.at_rest(_is_from_file)
            else:
                continue
            functions.let_go()

    def close(self) -> None:
        for functions in self._by_mesh.values():
            functions.retire()


def _is_from_file(term: str) -> bool:
    with suppress(AbfmError):
        return term in terms_from_files(term)
    return False


def known_values(document: Document, functions: Evaluators) -> dict[str, FloatArray]:
    """Return the values (V,) of a document's functions from files, which a project holds, by their
    names (`Document.known_as`).
    """
    known = {}
    given: list[tuple[Side, str]] = [("target", document.mask)] if document.mask else []
    given += [(side, channel.spec(side)) for channel in document.channels for side in SIDES]
    terms = {(side, term) for side, spec in given for term in terms_from_files(spec)}
    for side, term in terms:
        with suppress(AbfmError):  # what cannot be evaluated now has no values to keep
            known[document.values_key(side, term)] = functions.evaluate(term, side)
    return known

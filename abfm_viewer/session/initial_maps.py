"""The initial map from surface A to surface B, found off the frame loop, and what comes by it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm.workers.control import Control, controlled
from abfm.workers.progress import Step
from abfm_viewer.computing.background import Jobs, Latest, Memo, same
from abfm_viewer.computing.run import Process
from abfm_viewer.document.document import SIDES, InitialMap, Landmark, MapRequest, Side
from abfm_viewer.document.kinds import GIVEN_WORD, PairDocument
from abfm_viewer.document.surface_points import landmark_pairs
from abfm_viewer.session.functions import DocumentFunctions

if TYPE_CHECKING:
    from abfm.registration.initial.map_input import Initial, MapInput

_FIRST_WORD = "closest"
"""The word of the map that is shown while candidates are compared."""
_WITHOUT_FUNCTIONS = ("connectivity", "closest", "file")  # words of maps that use no functions
_WITHOUT_LANDMARKS = ("connectivity", "file")


class _ChannelValues(NamedTuple):
    """Values of sources on A, of targets on B, and of the mask on B; weights of the channels."""

    source: tuple[FloatArray, ...]
    target: tuple[FloatArray, ...]
    mask: FloatArray | None
    weights: tuple[float, ...]
    landmarks: tuple[Landmark, ...]


class _MapChoice(NamedTuple):
    """From which surface to which, and by which map, or word for one."""

    a: TriangleMesh
    b: TriangleMesh
    by: str | InitialMap


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """What is matched on B, and the map by which A's functions came there, which may be that of an
    earlier state of the document.
    """

    initial: InitialMap
    problem: abfm.Problem
    usual: Parameters | None = None  # what functions like these are best matched with


class InitialMaps:
    """Of the document that is shown: its map, and its functions on B as the flow has them.

    Until something newer is known, what was known of the same surfaces stays. A search by a word
    that is no longer wanted is ended.
    """

    def __init__(self, jobs: Jobs, functions: DocumentFunctions, process: Process | None) -> None:
        self._functions = functions
        self._prepared: Latest[PreparedMap] = jobs.latest()
        self._first: Latest[PreparedMap] = jobs.latest()  # shown while candidates are compared
        self._control, self._wanted = Control(), object()
        self._process = process
        self._maps: Memo[Initial] = Memo()
        self._first_maps: Memo[Initial] = Memo()
        self._of_result = Memo[PreparedMap]()
        self._columns: dict[Side, Memo[FloatArray]] = defaultdict(Memo)

    @property
    def busy(self) -> bool:
        return self._prepared.busy

    @property
    def step(self) -> Step | None:
        return self._prepared.step if self.busy else None

    @property
    def error(self) -> str:
        """Say why there is no map; nothing if there is one, or will be."""
        return "" if self.busy else self._prepared.error

    def prepared(self, document: PairDocument) -> PreparedMap | None:
        """Return what is known by now, lately of functions as they were; None before it is."""
        if not document.channels:
            return None
        kept, result = document.initial_map, document.result
        if kept is not None and result is not None and kept.is_for(document):
            of_result = kept, result.problem
            return self._of_result.get(of_result, lambda: PreparedMap(*of_result))
        given = self._given(document)
        a, b = (surface.mesh for surface in document.surfaces)
        wanted = (a, b), document.initial
        if given is None:
            key = self._prepared.key
            is_about = isinstance(key, tuple) and same(key[0], wanted)
            return self._prepared.value if is_about else None
        if not same(wanted, self._wanted):
            self._wanted = wanted
            self._control.cancel()
            self._control = Control()
        given_map = kept if document.initial == GIVEN_WORD else None
        way = _MapChoice(a, b, given_map or document.initial)
        asked = document.map_request
        found = self._prepared.newest(
            wanted, self._prepare, self._control, self._maps, way, given, asked
        )
        if found is not None or document.initial or not self._prepared.busy:
            return found
        way = way._replace(by=_FIRST_WORD)
        return self._first.newest(
            wanted, self._prepare, self._control, self._first_maps, way, given, asked
        )

    def flow_values(self, document: PairDocument, side: Side) -> FloatArray | None:
        """Return a side's function of the active channel on B, as a flow carries or meets it: a
        target in its own unit is the very array of its values.
        """
        prepared = self.prepared(document)
        if prepared is None:
            return None
        channel, own = document.channel, self._functions.values(document.function(side))
        functions = getattr(prepared.problem, side)
        if channel >= functions.shape[1]:  # one that has just come
            return None

        def column() -> FloatArray:
            values = np.ascontiguousarray(functions[:, channel])
            is_own = side == "target" and own is not None and np.array_equal(values, own)
            return own if is_own and own is not None else values

        return self._columns[side].get((prepared, channel, own), column)

    def _given(self, document: PairDocument) -> _ChannelValues | None:
        """Return the functions, the mask and the weights; None if some are unknown."""
        known, sides = self._functions.values, []
        for side in SIDES:
            found = [known(document.function(side, channel)) for channel in document.channels]
            present = tuple(values for values in found if values is not None)
            if len(present) < len(found):
                return None
            sides.append(present)
        mask = known(document.mask_function) if document.mask else None
        if document.mask and mask is None:
            return None
        source, target = sides
        return _ChannelValues(source, target, mask, document.weights, document.pairs)

    def _prepare(
        self,
        control: Control,
        maps: Memo[Initial],
        way: _MapChoice,
        given: _ChannelValues,
        asked: MapRequest,
    ) -> PreparedMap:
        source, target = (np.stack(own, axis=1) for own in (given.source, given.target))
        with controlled(control):
            initial = self._map(maps, way, given)
            found = abfm.registration.prepare(
                way.a,
                way.b,
                source,
                target,
                initial=initial.correspondence,
                landmarks=landmark_pairs(way.a, way.b, given.landmarks),
                mask_b=given.mask,
                weights=given.weights,
            )
        notes, usual = (*initial.notes, *found.notes), found.problem.parameters
        if maps is self._first_maps:
            notes = (f"the map {_FIRST_WORD} is shown while candidates are compared", *notes)
        made = InitialMap(found.initial, asked, notes, found.functions, initial.warnings)
        return PreparedMap(made, found.problem, usual)

    def _map(self, maps: Memo[Initial], way: _MapChoice, given: _ChannelValues) -> Initial:
        """Return the map, found anew where something changed that it asks for."""
        from abfm.registration.initial.map_input import Initial, MapInput

        if not isinstance(way.by, str):
            return Initial(way.by.correspondence, warnings=way.by.warnings)
        about = MapInput(way.a, way.b, landmarks=landmark_pairs(way.a, way.b, given.landmarks))
        if counts := any(given.weights):
            f, g = np.stack(given.source), np.stack(given.target)
            weights = np.array(given.weights)
            about = about._replace(f=f, g=g, mask_b=given.mask, weights=weights)
        word = way.by or "auto"
        base = word.partition(":")[0]
        by_functions = counts and base not in _WITHOUT_FUNCTIONS
        by_landmarks = base not in _WITHOUT_LANDMARKS
        functions = given.source, given.target, given.mask, given.weights
        asked = functions if by_functions else (), given.landmarks if by_landmarks else ()

        def find() -> Initial:
            if self._process is None:
                return _found(None, word, about)
            return self._process.solve(_found, word, about, tries=2)

        return maps.get((way.a, way.b, word, *asked), find)


def _found(_: object, word: str | None, given: MapInput) -> Initial:
    """Find a map, which takes seconds, in which libraries hold the interpreter."""
    from abfm.registration.initial.methods import initial_map

    return initial_map(word, given)

"""Computation, in the background, of initial maps from A to B, and of the functions of A on B.

Before a match of two surfaces, an initial map transfers the functions of surface A to B. There they
are matched.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm.workers.control import Control, controlled
from abfm.workers.progress import Overall, phase
from abfm_viewer.computing.background import Jobs, Latest, Memo, same
from abfm_viewer.computing.run import Process
from abfm_viewer.document.document import SIDES, InitialMap, Landmark, MapRequest, Side
from abfm_viewer.document.kinds import GIVEN_WORD, PairDocument
from abfm_viewer.document.surface_points import landmark_pairs
from abfm_viewer.session.functions import DocumentFunctions

if TYPE_CHECKING:
    from abfm.registration.correspondence import Candidate
    from abfm.registration.initial.map_input import Initial, MapInput

_FIRST_WORD = "closest"  # method of the map that is shown while others are compared
_WITHOUT_FUNCTIONS = ("connectivity", "closest", "file")  # methods without functions
_WITHOUT_LANDMARKS = ("connectivity", "file")


class _ChannelValues(NamedTuple):
    source: tuple[FloatArray, ...]
    target: tuple[FloatArray, ...]
    mask: FloatArray | None
    weights: tuple[float, ...]
    landmarks: tuple[Landmark, ...]
    map_landmarks: tuple[Landmark, ...]  # those by which the initial map is found


class _MapChoice(NamedTuple):
    """Surfaces A and B, and either an initial map or the name of a method that computes one."""

    a: TriangleMesh
    b: TriangleMesh
    method: str | InitialMap


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """Initial map from surface A to B, and the problem on B with the functions that it transferred.

    The document may have changed since they were computed.
    """

    initial: InitialMap
    problem: abfm.Problem
    suggested_parameters: Parameters | None = None  # for functions of this kind


class InitialMaps:
    """Computes the initial map from A to B of the current document, and the functions of A on B.

    While a new map is computed, the latest one of the same two surfaces is used. If the user
    chooses another method, the computation of the previous one is cancelled. While landmarks are
    placed, the map of the earlier landmarks is used.
    """

    def __init__(self, jobs: Jobs, functions: DocumentFunctions, process: Process | None) -> None:
        self._functions = functions
        self._prepared: Latest[PreparedMap] = jobs.latest()
        self._first: Latest[PreparedMap] = jobs.latest()  # map by `_FIRST_WORD`
        self._control, self._wanted = Control(), object()
        self._map_landmarks: tuple[Landmark, ...] = ()
        self._landmarks_of: object = None  # identity of the document with these landmarks
        self._latest_map: tuple[tuple[object, ...], Initial] | None = None
        self._process = process
        self._maps: Memo[Initial] = Memo()
        self._automatic: Memo[Initial] = Memo()  # the best of all maps, kept during other choices
        self._compared: tuple[object, tuple[Candidate, ...]] = None, ()
        self._first_maps: Memo[Initial] = Memo()
        self._of_result = Memo[PreparedMap]()
        self._columns: dict[str, Memo[FloatArray]] = defaultdict(Memo)

    @property
    def busy(self) -> bool:
        return self._prepared.busy

    @property
    def overall(self) -> Overall:
        """Progress of the computation."""
        return self._prepared.overall

    @property
    def error(self) -> str:
        """Reason why no initial map could be computed; empty during computation and on success."""
        return "" if self.busy else self._prepared.error

    def prepared(self, document: PairDocument) -> PreparedMap | None:
        """Request the initial map and the problem of a document; return the latest computed ones.

        Until new ones are computed, they may belong to earlier functions; None if there are none.
        """
        if not document.channels:
            return None
        present, result = document.initial_map, document.result
        if present is not None and result is not None and present.is_for(document):
            of_result = present, result.problem
            return self._of_result.get(of_result, lambda: PreparedMap(*of_result))
        self._choose_landmarks(document)
        given = self._given(document)
        a, b = (surface.mesh for surface in document.surfaces)
        wanted = (a, b), document.initial
        if given is None:
            key = self._prepared.key
            is_same = isinstance(key, tuple) and same(key[0], wanted)
            return self._prepared.value if is_same else None
        if not same(wanted, self._wanted):
            self._wanted = wanted
            self._control.cancel()
            self._control = Control()
        given_map = present if document.initial == GIVEN_WORD else None
        choice = _MapChoice(a, b, given_map or document.initial)
        request = document.map_request
        maps = self._maps if document.initial else self._automatic
        found = self._prepared.newest(
            wanted, self._prepare, self._control, maps, choice, given, request
        )
        if found is not None or document.initial or not self._prepared.busy:
            return found
        choice = choice._replace(method=_FIRST_WORD)
        return self._first.newest(
            wanted, self._prepare, self._control, self._first_maps, choice, given, request
        )

    def compared(self, document: PairDocument) -> tuple[Candidate, ...]:
        """Return the maps that the automatic choice compared for these functions, best first."""
        prepared, given = self.prepared(document), self._given(document)
        key = document.surfaces, given and given._replace(landmarks=())
        if document.initial == "" and prepared is not None:
            self._compared = key, prepared.initial.correspondence.candidates
        return self._compared[1] if same(self._compared[0], key) else ()

    def flow_values(self, document: PairDocument, side: Side) -> FloatArray | None:
        """Return the active source or target as matched on surface B, (V,); None until known.

        Its values may be in standard deviations. A target that is matched without a change is the
        same array as its function.
        """
        prepared = self.prepared(document)
        if prepared is None:
            return None
        channel, values_of_side = document.channel, self._functions.values(document.function(side))
        functions = getattr(prepared.problem, side)
        if channel >= functions.shape[1]:  # a channel that was just added
            return None

        def column() -> FloatArray:
            values = np.ascontiguousarray(functions[:, channel])
            if side == "target" and values_of_side is not None:
                return values_of_side if np.array_equal(values, values_of_side) else values
            return values

        return self._columns[side].get((prepared, channel, values_of_side), column)

    def source_on_a(self, document: PairDocument) -> FloatArray | None:
        prepared, channel = self.prepared(document), document.channel
        functions = None if prepared is None else prepared.initial.functions
        if functions is None or channel >= functions.shape[1]:
            return None
        column = partial(np.ascontiguousarray, functions[:, channel])
        return self._columns["on A"].get((functions, channel), column)

    def _choose_landmarks(self, document: PairDocument) -> None:
        """Choose the landmarks for the initial map, which stay the same while others are placed."""
        is_placing = document.view.tool == "landmark" and self._landmarks_of is document.identity
        needs_more = document.initial.startswith("landmarks") and len(self._map_landmarks) < 3
        if needs_more or not is_placing:
            self._map_landmarks, self._landmarks_of = document.pairs, document.identity

    def waits_for_placing(self, document: PairDocument) -> bool:
        """Return whether the initial map is found anew, by other landmarks, when placing stops."""
        return self._landmarks_of is document.identity and self._map_landmarks != document.pairs

    def _given(self, document: PairDocument) -> _ChannelValues | None:
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
        pairs = document.pairs
        return _ChannelValues(source, target, mask, document.weights, pairs, self._map_landmarks)

    def _prepare(
        self,
        control: Control,
        maps: Memo[Initial],
        choice: _MapChoice,
        given: _ChannelValues,
        request: MapRequest,
    ) -> PreparedMap:
        source, target = (np.stack(values, axis=1) for values in (given.source, given.target))
        with controlled(control):
            initial = self._map(maps, choice, given)
            found = abfm.registration.prepare(
                choice.a,
                choice.b,
                source,
                target,
                initial=initial.correspondence,
                landmarks=landmark_pairs(choice.a, choice.b, given.landmarks),
                mask_b=given.mask,
                weights=given.weights,
            )
        notes = (*initial.notes, *found.notes)
        if maps is self._first_maps:
            notes = (f"the initial map {_FIRST_WORD} is shown while all maps are compared", *notes)
        made = InitialMap(found.initial, request, notes, found.functions, initial.warnings)
        return PreparedMap(made, found.problem, found.problem.parameters)

    def _map(self, maps: Memo[Initial], choice: _MapChoice, given: _ChannelValues) -> Initial:
        """Return the chosen initial map, which is computed again only if its inputs changed."""
        from abfm.registration.initial.map_input import Initial, MapInput

        a, b, method = choice
        if not isinstance(method, str):
            return Initial(method.correspondence, warnings=method.warnings)
        inputs = MapInput(a, b, landmarks=landmark_pairs(a, b, given.map_landmarks))
        if counts := any(given.weights):
            f, g = np.stack(given.source), np.stack(given.target)
            weights = np.array(given.weights)
            inputs = inputs._replace(f=f, g=g, mask_b=given.mask, weights=weights)
        word = method or "auto"
        base = word.partition(":")[0]
        by_functions = counts and base not in _WITHOUT_FUNCTIONS
        by_landmarks = base not in _WITHOUT_LANDMARKS
        functions = given.source, given.target, given.mask, given.weights
        used = functions if by_functions else (), given.map_landmarks if by_landmarks else ()
        key, latest = (a, b, word, used[1]), self._latest_map
        if not counts and latest is not None and same(latest[0], key):
            return latest[1]  # the map by functions also suits landmarks alone

        def find() -> Initial:
            if self._process is None:
                return _find_map(None, word, inputs)
            return self._process.solve(_find_map, word, inputs, tries=2)

        found = maps.get((a, b, word, *used), find)
        if maps is not self._first_maps:
            self._latest_map = key, found
        return found


def _find_map(_: object, word: str | None, given: MapInput) -> Initial:
    """Compute an initial map by a method; "auto" compares all methods that apply.

    This runs in a subprocess, because libraries block Python for seconds.
    """
    from abfm.registration.initial.methods import initial_map

    with phase("initial map"):
        return initial_map(word, given)

"""What a session does with documents of each kind: what it computes for one, and its run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import abfm
from abfm import Parameters
from abfm.types import FloatArray
from abfm.wording import counted
from abfm.workers.progress import Step
from abfm_viewer.computing.background import Latest, Memo, same
from abfm_viewer.computing.evaluation import Evaluators, Functions
from abfm_viewer.computing.matching import ProblemSpec, Snapshot
from abfm_viewer.document.document import Document, Identity, Point, RunRecord, Side, View
from abfm_viewer.document.frame_sequence import FRAMES_A_SECOND
from abfm_viewer.document.kinds import MatchDocument, PairDocument, SequenceDocument
from abfm_viewer.document.surface_points import points_of, surface_points
from abfm_viewer.document.verdict_words import residual_text, stage_text
from abfm_viewer.session.initial_maps import PreparedMap
from abfm_viewer.session.notices import RUN, Remedies
from abfm_viewer.session.parts import Parts

Start = Callable[[bool | None], None]
"""Starts a run, as `Session.match` does."""
_STREAK_FACES_MAX = 50_000  # of a mesh that gets streaks after a match: within two seconds


class MatchRun:
    """What the result of a match changes in the document, which may be another by then.

    `remedied` is the number of moves of the history when a remedy began the run: its result belongs
    to that step.
    """

    def __init__(self, parts: Parts, start: Start) -> None:
        self._parts, self._start = parts, start
        self.began: Document = parts.document
        self.remedied = -1
        self.flow_seen: Identity | None = None  # of a document whose flow was shown

    @property
    def snapshot(self) -> Snapshot | None:
        is_of_run = self.began.identity is self._parts.document.identity
        return self._parts.matching.snapshot if is_of_run else None

    def start(self, problem: ProblemSpec, functions: Evaluators, field: FloatArray | None) -> None:
        self.began, self.remedied = self._parts.document, -1
        self._parts.matching.start(problem, functions, self._take, field)

    def _take(
        self, match: abfm.Match | None, record: RunRecord | None, solved: ProblemSpec
    ) -> None:
        parts, solver = self._parts, self._parts.solver
        parts.notices.resolve(RUN)
        replaced = self.began.identity is not parts.document.identity
        document = self.began if replaced else parts.document
        self.began = parts.document
        assert isinstance(document, MatchDocument)
        outcome = document.outcome(match, record, solved.initial)
        if match is not None:
            parts.saves.add_unsaved(replace(document, **outcome))
        if replaced:
            solver.forget()
            return
        again: Remedies = {"Try again": partial(self._start, None)}
        if match is not None:  # the newest field that was known
            again = {
                "Continue": partial(self._start, True),
                "Match again": partial(self._start, False),
            }
            self._show(match, outcome)
        if solver.failed:
            parts.notices.show(f"the solver stopped: {solver.reason}", True, RUN, again)

    def _show(self, match: abfm.Match, outcome: dict[str, Any]) -> None:
        parts, editor = self._parts, self._parts.editor
        view = None
        if not (parts.solver.failed or parts.at_once or parts.dragging):
            view = self._view_of_flow(match)
        outcome["view"] = view or parts.view
        if self.remedied == editor.action_count:
            editor.amend(**outcome)
        else:
            editor.change("match", **outcome)
        if view is not None:
            editor.amend(time=0.0)
            parts.player.play_once()

    def _view_of_flow(self, match: abfm.Match) -> View | None:
        """The view of the flow after a match; None where there is nothing to play.

        Streaks where there is time for them, else arrows. The flow is left as the user has it if it
        is shown already, or is shown as something else than the function; and where the user hid it
        after an earlier match of this document, it stays hidden.
        """
        view, document = self._parts.view, self._parts.document
        if not view.flow_after_match or not match.velocity.any():
            return None
        known, self.flow_seen = self.flow_seen is document.identity, document.identity
        if known or view.arrows or view.streaks or view.coloring != "function":
            return view
        streaks = self._parts.draws_quickly and len(match.mesh.faces) <= _STREAK_FACES_MAX
        return replace(view, streaks=streaks, arrows=not streaks)


class Work(ABC):
    """Answers about the document that is shown; here those that need no functions by specs."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts

    @property
    def busy(self) -> str:
        """Say what is computed of the document in the background."""
        return ""

    @property
    def step(self) -> Step | None:
        """How far that is."""
        return None

    @property
    @abstractmethod
    def progress(self) -> str:
        """What a run does, in a line."""

    @property
    def obstacle(self) -> str:
        """Say why a match cannot start; nothing if it can."""
        return ""

    @property
    def blocking_problem(self) -> str:
        """Say what keeps a match from starting until the user does something about it."""
        return ""

    @property
    def prepared(self) -> PreparedMap | None:
        """What is matched on surface B of two, as far as it is known by now."""
        return None

    @property
    def expected_facts(self) -> abfm.outcome.Facts | None:
        """What is known of a match before it is solved; None if nothing prevents it, or before
        that is known.
        """
        return None

    @property
    def facts(self) -> abfm.outcome.Facts | None:
        """What is reported of the result."""
        result = self.parts.document.result
        return None if result is None else result.facts

    @property
    def outdated(self) -> bool:
        return self.parts.document.is_outdated

    @abstractmethod
    def values(self, side: Side) -> FloatArray | None:
        """The active channel's function of a side on its surface, (V,), if it is known; of a film
        the frame before or after the shown time.
        """

    def flow_values(self, side: Side) -> FloatArray | None:
        """The same as a flow carries or meets it, (V,), on B where there are two surfaces."""
        return self.values(side)

    def error(self, of: Side | Literal["mask"]) -> str:
        """Say why the active channel's source or target, or the mask, has no values."""
        return ""

    def on_flow(self, slot: str, point: Point) -> Point | None:
        """Return a point of a slot where the flow meets it; None where that is not known."""
        return point

    def defaults(self) -> tuple[tuple[str, str] | None, str]:
        """Return specs of a source and a target, None before they are known, and why there are
        none.
        """
        return None, ""

    @abstractmethod
    def start(self, from_current_field: bool | None) -> None:
        """Start a run. By default `from_current_field` is the switch of the panel Match."""

    @abstractmethod
    def follow(self) -> None:
        """Compute what the document asks for: call once per frame."""

    @abstractmethod
    def next_time(self, elapsed: float) -> float:
        """Return the time that is shown after so many seconds."""


class MatchWork(Work):
    """Functions on one surface: their values, and the match of them."""

    def __init__(self, parts: Parts, run: MatchRun) -> None:
        super().__init__(parts)
        self._run = run
        self._defaults: Latest[tuple[str, str]] = parts.jobs.latest()
        self._coarse_meshes: Latest[None] = parts.jobs.latest()
        self._foreseen: Latest[abfm.outcome.Facts | None] = parts.jobs.latest()
        self._is_outdated = Memo[bool]()
        self._compared: tuple[abfm.Match | None, bool] = None, False  # a result, and its answer

    @property
    def document(self) -> MatchDocument:
        document = self.parts.document
        assert isinstance(document, MatchDocument)
        return document

    @property
    def outdated(self) -> bool:
        """Whether the result was found for another problem; False without a result.

        While new values are being computed, the answer is the one before. Of two surfaces the
        result is of what its initial map was found for.
        """
        document, known = self.document, self.parts.functions.values
        if (result := document.result) is None:
            return False
        values = [known(function) for function in document.functions]

        def compare() -> bool:
            is_known = self._unknown or all(one is not None for one in values)
            if result is not self._compared[0] or is_known:
                self._compared = result, document.differs(result, known)
            return self._compared[1]

        problem = document.parameters, document.map_request
        return self._is_outdated.get((result, problem, document.initial_map, *values), compare)

    def values(self, side: Side) -> FloatArray | None:
        if self.document.active is None:
            return None
        return self.parts.functions.values(self.document.function(side))

    def error(self, of: Side | Literal["mask"]) -> str:
        document, functions = self.document, self.parts.functions
        if of == "mask":
            return functions.error(document.mask_function)
        return functions.error(document.function(of)) if document.active else ""

    @property
    def _evaluating(self) -> list[Functions]:
        return [self.parts.functions.of(surface.mesh) for surface in self.document.surfaces]

    @property
    def busy(self) -> str:
        if not self.document.channels and not self._defaults.error:
            return "choosing functions"
        is_busy = any(functions.busy for functions in self._evaluating)
        return "computing functions" if is_busy else ""

    @property
    def step(self) -> Step | None:
        if not self.document.channels:
            return self._defaults.step
        return next((each.step for each in self._evaluating if each.step), None)

    @property
    def progress(self) -> str:
        solver, snapshot = self.parts.solver, self.parts.matching.snapshot
        if snapshot is None:
            return solver.step.text() if solver.step else "starting the solver"
        left = residual_text(snapshot.iteration, snapshot.problem.is_of_landmarks)
        state = "paused" if solver.paused else "solving"
        return f"{state}, {stage_text(snapshot.iteration)}, {left}"

    @property
    def obstacle(self) -> str:
        document, known = self.document, self.parts.functions.values
        if not document.channels:
            return "a source and a target for this mesh are being chosen"
        if unknown := self._unknown:
            return unknown
        if any(known(function) is None for function in document.functions):
            return "the functions are being computed"
        mask = known(document.mask_function)
        if mask is not None and (mask.min() < 0 or not mask.any()):
            return "the mask must not be negative, nor zero everywhere"
        has_weight = any(channel.weight for channel in document.channels)
        return "" if has_weight or document.is_of_landmarks else "all channels have the weight 0"

    @property
    def blocking_problem(self) -> str:
        return self._unknown

    @property
    def _unknown(self) -> str:
        """Return which function has no values, and why; empty if all have some, or will."""
        errors = ((one.spec, self.parts.functions.error(one)) for one in self.document.functions)
        return next((f"{spec}: {error}" for spec, error in errors if error), "")

    @property
    def problem(self) -> ProblemSpec:
        document, prepared = self.document, self.prepared
        return ProblemSpec(
            document.surface().mesh,
            document.channels,
            document.parameters,
            document.mask,
            document.pairs,
            document.landmarks_alone,
            None if prepared is None else prepared.initial,
        )

    @property
    def expected_facts(self) -> abfm.outcome.Facts | None:
        if self.parts.solver.running or self.obstacle:
            return None
        goal = Parameters(goal=self.document.parameters.goal)
        spec = replace(self.problem, parameters=goal)
        given = spec, self.parts.functions.of_document(self.document)
        return self._foreseen.newest(spec.mesh, _foreseen, *given)

    def defaults(self) -> tuple[tuple[str, str] | None, str]:
        """Of two surfaces each gets what would be its source alone."""
        evaluating = self._evaluating
        meshes = tuple(functions.mesh for functions in evaluating)

        def choose() -> tuple[str, str]:
            (source, target), *second = [functions.defaults() for functions in evaluating]
            return source, second[0][0] if second else target

        found = self._defaults.ask(meshes, choose)
        return found, self._defaults.error if same(self._defaults.key, meshes) else ""

    def start(self, from_current_field: bool | None) -> None:
        parts = self.parts
        self.take_usual_parameters()
        field, document = None, self.document
        warm = parts.matching.warm if from_current_field is None else from_current_field
        result, mesh = document.result, document.surface().mesh
        if warm and result is not None and result.mesh.digest == mesh.digest:
            field = result.start_for(document.parameters)
        parts.player.playing = False
        parts.editor.amend(time=document.parameters.tau)
        self._run.start(self.problem, parts.functions.of_document(self.document), field)

    def take_usual_parameters(self) -> None:
        """Match functions as their kind is, unless the user set parameters."""

    def follow(self) -> None:
        parts = self.parts
        parts.functions.update(self.document)
        obstacle = self.obstacle
        # the functions come first, and pictures off the screen solve nothing
        if not (obstacle or parts.at_once):
            # a match that begins earlier waits for its coarse meshes
            mesh, parameters = self.document.surface().mesh, self.document.parameters
            prepare = partial(parts.matching.prepare, mesh, parameters)
            self._coarse_meshes.ask((mesh, parameters.solver.levels), prepare)
        if parts.dragging or not obstacle:  # what cannot be evaluated must not end a run
            parts.matching.follow_problem(self.problem, parts.dragging)

    def next_time(self, elapsed: float) -> float:
        document = self.document
        tau, end = document.parameters.tau, document.end
        return self.parts.player.advance(document.time, elapsed, tau, end)


class PairWork(MatchWork):
    """Two surfaces: the initial map as well, by which functions of A come to B."""

    def __init__(self, parts: Parts, run: MatchRun) -> None:
        super().__init__(parts, run)
        self._facts: Latest[abfm.outcome.Facts] = parts.jobs.latest()

    @property
    def document(self) -> PairDocument:
        document = self.parts.document
        assert isinstance(document, PairDocument)
        return document

    @property
    def prepared(self) -> PreparedMap | None:
        return self.parts.initial_maps.prepared(self.document)

    @property
    def facts(self) -> abfm.outcome.Facts | None:
        """What is reported of the match on B, marked as incomplete, until the complete map is
        measured.
        """
        result, found = self.document.result, self.document.complete_result
        if result is None or found is None or found is result:
            return super().facts
        facts = self._facts.ask(found, lambda: found.facts)
        return facts or replace(result.facts, is_complete=False)

    def flow_values(self, side: Side) -> FloatArray | None:
        if self.document.active is None:
            return None
        return self.parts.initial_maps.flow_values(self.document, side)

    @property
    def busy(self) -> str:
        finding = "finding the initial map" if self.parts.initial_maps.busy else ""
        return super().busy or finding

    @property
    def step(self) -> Step | None:
        return super().step or self.parts.initial_maps.step

    @property
    def obstacle(self) -> str:
        maps = self.parts.initial_maps
        is_under_way = maps.busy and not self.parts.solver.running
        if not (obstacle := super().obstacle) and (self.prepared is None or is_under_way):
            return maps.error or "the initial map is being found"
        return obstacle

    @property
    def blocking_problem(self) -> str:
        error = self.parts.initial_maps.error if self.prepared is None else ""
        return super().blocking_problem or error

    def on_flow(self, slot: str, point: Point) -> Point | None:
        if slot != "source":
            return point
        if (prepared := self.prepared) is None:
            text = "no point on A yet: there is no initial map that takes it to B"
            self.parts.notices.show(text)
            return None
        on_a = surface_points(self.document.surface(slot).mesh, [point])
        [carried] = points_of(prepared.initial.correspondence.transfer_points(on_a))
        return carried

    def take_usual_parameters(self) -> None:
        usual = self.prepared.usual if self.prepared else None
        if usual is not None and usual != self.document.parameters == Parameters():
            label = "parameters for measured functions"
            self.parts.editor.set_parameter(label=label, **usual.to_dict())
            text = f"{label} were set, as the functions of A and B look measured"
            self.parts.notices.show(text)


class SequenceWork(Work):
    """A film: its frames are there, and all its intervals are matched in one run."""

    def __init__(self, parts: Parts, start: Start) -> None:
        super().__init__(parts)
        self._start = start

    @property
    def document(self) -> SequenceDocument:
        document = self.parts.document
        assert isinstance(document, SequenceDocument)
        return document

    def values(self, side: Side) -> FloatArray | None:
        document = self.document
        frame = document.interval + (side == "target")
        return document.sequence.columns[frame][document.channel]

    @property
    def progress(self) -> str:
        return self.parts.sequence_match.progress_text

    def start(self, from_current_field: bool | None) -> None:
        self.parts.sequence_match.start(self.document, partial(self._take, False))

    def recover(self) -> None:
        """Show what an earlier run has found, and solve nothing."""
        then = partial(self._take, True)
        self.parts.sequence_match.start(self.document, then, resumes_only=True)

    def follow(self) -> None:
        self.parts.functions.waiting_since = None

    def next_time(self, elapsed: float) -> float:
        document = self.document
        start, whole = document.start, document.end - document.start
        seconds = document.sequence.intervals / FRAMES_A_SECOND
        time = self.parts.player.advance(document.time - start, elapsed, whole, whole, seconds)
        return min(start + time, document.end)

    def _take(
        self, is_recovery: bool, began: SequenceDocument, found: abfm.Sequence | None
    ) -> None:
        parts, solver = self.parts, self.parts.solver
        if found is None:
            again = {"Try again": partial(self._start, None)}
            parts.notices.show(f"the solver stopped: {solver.reason}", True, RUN, again)
            solver.forget()
            return
        count = int(found.solved.sum())
        if parts.document.identity is not began.identity:
            if count:
                parts.saves.add_unsaved(replace(began, result=found))
            return
        if is_recovery:
            if count:
                parts.editor.amend(result=found)
            return
        earlier = self.document.result
        if count:  # else nothing takes the place of what there is
            view = replace(self.document, result=found).view_of_result(parts.view)
            parts.editor.change("match all frames", result=found, view=view)
            if view.flow_after_match:
                parts.editor.amend(time=self.document.start)
                parts.player.play_once()
        if count < len(found):
            parts.notices.show(_broken_off(count, len(found), earlier))


def _foreseen(spec: ProblemSpec, functions: Evaluators) -> abfm.outcome.Facts | None:
    return abfm.matching.expected_facts(spec.problem(functions))


def _broken_off(count: int, whole: int, earlier: abfm.Sequence | None) -> str:
    """Say what a film's run that was cancelled has found, and where its earlier result is."""
    told = f"cancelled: {count} of {counted(whole, 'interval')} found"
    if earlier is None or not earlier.solved.any():
        return told
    if not count:
        return f"{told}, the earlier result stays"
    more = int(earlier.solved.sum())
    return f"{told}; Undo (Ctrl+Z) brings back the earlier result, which has {more}"

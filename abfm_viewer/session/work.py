"""Computations of a session for its document: a match, a pair of surfaces, or a sequence."""

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
from abfm.workers.progress import Overall, Step
from abfm_viewer.computing.background import Latest, Memo, same
from abfm_viewer.computing.evaluation import Evaluators, Functions
from abfm_viewer.computing.matching import ProblemSpec, Snapshot
from abfm_viewer.document.document import Document, Identity, Point, RunRecord, Side, View
from abfm_viewer.document.frame_sequence import FRAMES_A_SECOND
from abfm_viewer.document.keyboard import hint
from abfm_viewer.document.kinds import MatchDocument, PairDocument, SequenceDocument
from abfm_viewer.document.surface_points import points_of, surface_points
from abfm_viewer.document.verdict_words import residual_text, stage_text
from abfm_viewer.session.initial_maps import PreparedMap
from abfm_viewer.session.notices import RUN, Remedies
from abfm_viewer.session.parts import Parts

Start = Callable[[bool], None]  # starts a run, as `Session.match` does
_STREAK_FACES_MAX = 50_000  # on larger meshes, where streaks take 2 s, a match is shown by arrows


class MatchRun:
    """Starts runs of the solver for a match, and enters their results in the document.

    The user may open another document during the run. The result then counts as an unsaved
    document.
    """

    def __init__(self, parts: Parts, start: Start) -> None:
        self._parts, self._start = parts, start
        self.document: Document = parts.document  # document for which the run started
        # `Editor.action_count` when a remedy started the run; the result joins that step of undo
        self.remedy_action = -1
        self.shown_flow_of: Identity | None = None  # last document whose flow was shown

    @property
    def snapshot(self) -> Snapshot | None:
        is_of_run = self.document.identity is self._parts.document.identity
        return self._parts.matching.snapshot if is_of_run else None

    def start(self, problem: ProblemSpec, functions: Evaluators, field: FloatArray | None) -> None:
        self.document, self.remedy_action = self._parts.document, -1
        self._parts.matching.start(problem, functions, self._take, field)

    def _take(
        self, match: abfm.Match | None, record: RunRecord | None, solved: ProblemSpec
    ) -> None:
        parts, solver = self._parts, self._parts.solver
        parts.notices.resolve(RUN)
        replaced = self.document.identity is not parts.document.identity
        document = self.document if replaced else parts.document
        self.document = parts.document
        assert isinstance(document, MatchDocument)
        outcome = document.outcome(match, record, solved.initial)
        if match is not None:
            parts.saves.add_unsaved(replace(document, **outcome))
        if replaced:
            solver.forget()
            return
        again: Remedies = {"Try again": partial(self._start, False)}
        if match is not None:
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
        if self.remedy_action == editor.action_count:
            editor.amend(**outcome)
        else:
            editor.change("match", **outcome)
        if view is not None:
            editor.amend(time=0.0)
            parts.player.play_once()

    def _view_of_flow(self, match: abfm.Match) -> View | None:
        """Return the view in which the flow is played after a match; None if it is not played.

        The view shows streaks if they can be drawn quickly, otherwise arrows. Nothing is added if
        the current view shows the flow already, or colours the surface by the field. Later matches
        of the same document add nothing either, because the user may have hidden the flow.
        """
        view, document = self._parts.view, self._parts.document
        if not view.flow_after_match or not match.velocity.any():
            return None
        was_shown = self.shown_flow_of is document.identity
        self.shown_flow_of = document.identity
        if was_shown or view.arrows or view.streaks or view.coloring != "function":
            return view
        streaks = self._parts.draws_quickly and len(match.mesh.faces) <= _STREAK_FACES_MAX
        return replace(view, streaks=streaks, arrows=not streaks)


class Work(ABC):
    """Computations for the current document; the defaults are for documents without functions."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts

    @property
    def busy(self) -> str:
        return ""

    @property
    def step(self) -> Step | None:
        return None

    @property
    def overall(self) -> Overall | None:
        """Progress of the preparation of a run, if it takes long; else None."""
        return None

    @property
    @abstractmethod
    def progress(self) -> str:
        """Progress of the current run in one line."""

    @property
    def obstacle(self) -> str:
        return ""

    @property
    def blocking_problem(self) -> str:
        """Error that prevents a match until the user changes something; empty without one."""
        return ""

    @property
    def prepared(self) -> PreparedMap | None:
        """Initial map and problem of two surfaces; None for one surface, or if not computed."""
        return None

    @property
    def expected_obstacles(self) -> tuple[abfm.outcome.Facts, ...]:
        """Facts about each obstacle to a match that is known before solving."""
        return ()

    @property
    def expected_facts(self) -> abfm.outcome.Facts | None:
        """Facts that show, before solving, that a match cannot succeed; None if it may succeed."""
        return next(iter(self.expected_obstacles), None)

    @property
    def sufficient_smoothing(self) -> tuple[int, float] | None:
        """A channel and a length, see `abfm.matching.sufficient_smoothing`; None if unknown."""
        return None

    @property
    def facts(self) -> abfm.outcome.Facts | None:
        result = self.parts.document.result
        return None if result is None else result.facts

    @property
    def outdated(self) -> bool:
        return self.parts.document.is_outdated

    @abstractmethod
    def values(self, side: Side) -> FloatArray | None:
        """Return the active channel's source or target on its surface, (V,); None if unknown."""

    def flow_values(self, side: Side) -> FloatArray | None:
        """Return the active channel's source or target as it is matched, (V,); None if unknown.

        With two surfaces, both are on surface B, and their values may be in standard deviations.
        """
        return self.values(side)

    @property
    def source_on_a(self) -> FloatArray | None:
        """The active source on A of two surfaces, scaled as in the match, (V_A,), or None."""
        return None

    def error(self, of: Side | Literal["mask"]) -> str:
        """Return why the active source or target, or the mask, has no values; empty if it has."""
        return ""

    def on_flow(self, slot: str, point: Point) -> Point | None:
        """Return a point of a picture on the flow's surface; None, with a notice, if unknown."""
        return point

    def defaults(self) -> tuple[tuple[str, str] | None, str]:
        """Return the specs (texts) of default functions, None if unknown, and an error or ""."""
        return None, ""

    @property
    def continues(self) -> bool:
        """Whether the result is unfinished, so that the next run usually continues from it."""
        return False

    @abstractmethod
    def start(self, from_current_field: bool) -> None:
        """Start a run from the current field or from zero, as described in `Session.match`."""

    @abstractmethod
    def follow(self) -> None:
        """Start the computations that the document needs now; called before each drawing."""

    @abstractmethod
    def next_time(self, elapsed: float) -> float:
        """Return the time to show after playing for ``elapsed`` more seconds."""


class MatchWork(Work):
    """Computations for the functions of one surface and for their match."""

    def __init__(self, parts: Parts, run: MatchRun) -> None:
        super().__init__(parts)
        self._run = run
        self._defaults: Latest[tuple[str, str]] = parts.jobs.latest()
        self._coarse_meshes: Latest[None] = parts.jobs.latest()
        self._expected: Latest[tuple[abfm.outcome.Facts, ...]] = parts.jobs.latest()
        self._smoothing: Latest[tuple[int, float] | None] = parts.jobs.latest()
        self._is_outdated = Memo[bool]()
        # the last result that was compared, and whether it is outdated
        self._compared: tuple[abfm.Match | None, bool] = None, False

    @property
    def document(self) -> MatchDocument:
        document = self.parts.document
        assert isinstance(document, MatchDocument)
        return document

    @property
    def outdated(self) -> bool:
        """Whether the document's inputs differ from those of the result; False without a result.

        While values of changed functions are computed, the property keeps its last value. For two
        surfaces, the inputs of the initial map are compared.
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

    @property
    def continues(self) -> bool:
        if (match := self.document.result) is None or self.outdated:
            return False
        remedies = match.verdict.remedies
        is_advised = any(each.starts_from_field and not each.parameters for each in remedies)
        return is_advised or match.stop_reason.is_interrupted

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
            return self._defaults.overall.step
        return next((each.step for each in self._evaluating if each.step), None)

    @property
    def progress(self) -> str:
        solver, snapshot = self.parts.solver, self.parts.matching.snapshot
        parts = ["paused" if solver.paused else solver.overall.name, solver.overall.text()]
        if snapshot is not None:
            parts += [stage_text(snapshot.iteration), residual_text(snapshot.iteration)]
        return ", ".join(filter(None, parts))

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
            return (
                "the mask is below 0 somewhere or 0 everywhere; use values of 0 or more, not all 0"
            )
        has_weight = any(channel.weight for channel in document.channels)
        no_weight = "all channels have weight 0; give one of them a weight above 0"
        return "" if has_weight or document.is_of_landmarks else no_weight

    @property
    def blocking_problem(self) -> str:
        return self._unknown

    @property
    def _unknown(self) -> str:
        """Text of the first function that cannot be evaluated, and why; empty if there is none."""
        errors = ((one.spec, self.parts.functions.error(one)) for one in self.document.functions)
        spec, error = next((pair for pair in errors if pair[1]), ("", ""))
        # an error of a file begins with its name, which is also in the spec
        reason = error.partition(": ")[2] if error.startswith("file ") else error
        return f"{spec}: {reason}" if error else ""

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
    def expected_obstacles(self) -> tuple[abfm.outcome.Facts, ...]:
        if self.obstacle:
            return ()
        goal = Parameters(goal=self.document.parameters.goal)
        spec = replace(self.problem, parameters=goal)
        given = spec, self.parts.functions.of_document(self.document)

        def find(spec: ProblemSpec, functions: Evaluators) -> tuple[abfm.outcome.Facts, ...]:
            return abfm.matching.expected_obstacles(spec.problem(functions))

        return self._expected.newest(spec.mesh, find, *given) or ()

    @property
    def sufficient_smoothing(self) -> tuple[int, float] | None:
        if self.obstacle:
            return None
        spec = replace(self.problem, parameters=Parameters())
        functions = self.parts.functions.of_document(self.document)

        def find() -> tuple[int, float] | None:
            return abfm.matching.sufficient_smoothing(spec.problem(functions))

        return self._smoothing.request((spec, functions), find)

    def defaults(self) -> tuple[tuple[str, str] | None, str]:
        """Return specs of the default source and target, None until known, and an error or "".

        On two surfaces, source and target are the default source of each surface.
        """
        evaluating = self._evaluating
        meshes = tuple(functions.mesh for functions in evaluating)

        def choose() -> tuple[str, str]:
            (source, target), *second = [functions.defaults() for functions in evaluating]
            return source, second[0][0] if second else target

        found = self._defaults.request(meshes, choose)
        return found, self._defaults.error if same(self._defaults.key, meshes) else ""

    def start(self, from_current_field: bool) -> None:
        parts = self.parts
        self.take_usual_parameters()
        field, document = None, self.document
        result, mesh = document.result, document.surface().mesh
        if from_current_field and result is not None and result.mesh.digest == mesh.digest:
            field = result.start_for(document.parameters)
        parts.player.playing = False
        parts.editor.amend(time=document.parameters.tau)
        self._run.start(self.problem, parts.functions.of_document(self.document), field)

    def take_usual_parameters(self) -> None:
        """Set the parameters that suit the functions, unless the user changed parameters.

        Only documents of two surfaces have such parameters.
        """

    def follow(self) -> None:
        parts = self.parts
        parts.functions.update(self.document)
        obstacle = self.obstacle
        # solve only when the functions are known, and never for off-screen pictures
        if not (obstacle or parts.at_once):
            # coarse meshes are prepared in advance, because a match has to wait for them
            mesh, parameters = self.document.surface().mesh, self.document.parameters
            prepare = partial(parts.matching.prepare, mesh, parameters)
            self._coarse_meshes.request((mesh, parameters.solver.levels), prepare)
        if parts.dragging or not obstacle:  # a function with an error must not end a run
            parts.matching.follow_problem(self.problem, parts.dragging)

    def next_time(self, elapsed: float) -> float:
        document = self.document
        tau, end = document.parameters.tau, document.end
        return self.parts.player.advance(document.time, elapsed, tau, end)


class PairWork(MatchWork):
    """Computations for a match of two surfaces, including the initial map from A to B."""

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
        """Facts of the registration of surface A to B; None without a result.

        Until the complete map from A to B is measured, these are the facts of the match on B,
        marked as incomplete.
        """
        result, found = self.document.result, self.document.complete_result
        if result is None or found is None or found is result:
            return super().facts
        facts = self._facts.request(found, lambda: found.facts)
        return facts or replace(result.facts, is_complete=False)

    def flow_values(self, side: Side) -> FloatArray | None:
        if self.document.active is None:
            return None
        return self.parts.initial_maps.flow_values(self.document, side)

    @property
    def source_on_a(self) -> FloatArray | None:
        return self.parts.initial_maps.source_on_a(self.document)

    @property
    def busy(self) -> str:
        if super().busy or (overall := self.overall) is None:
            return super().busy
        return ", ".join(filter(None, ("finding the initial map", overall.text())))

    @property
    def overall(self) -> Overall | None:
        maps = self.parts.initial_maps
        return maps.overall if maps.busy else None

    @property
    def obstacle(self) -> str:
        maps = self.parts.initial_maps
        if obstacle := super().obstacle:
            return obstacle
        prepared = self.prepared  # may start a computation
        is_computing = maps.busy and not self.parts.solver.running
        known = prepared is not None and not is_computing
        return "" if known else maps.error or "the initial map is being computed"

    @property
    def blocking_problem(self) -> str:
        error = self.parts.initial_maps.error if self.prepared is None else ""
        return super().blocking_problem or error

    def on_flow(self, slot: str, point: Point) -> Point | None:
        if slot != "source":
            return point
        if (prepared := self.prepared) is None:
            text = "no point can be placed on A yet: the initial map to B is not computed"
            self.parts.notices.show(text)
            return None
        on_a = surface_points(self.document.surface(slot).mesh, [point])
        [on_b] = points_of(prepared.initial.correspondence.transfer_points(on_a))
        return on_b

    def take_usual_parameters(self) -> None:
        suggested = self.prepared.suggested_parameters if self.prepared else None
        if suggested is not None and suggested != self.document.parameters == Parameters():
            label = "parameters for measured functions"
            self.parts.editor.set_parameter(label=label, **suggested.to_dict())
            text = f"{label} were set, because the functions of A and B seem to be measured"
            self.parts.notices.show(text)


class SequenceWork(Work):
    """Computations for a sequence of frames, whose intervals are all matched in one run."""

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

    @property
    def continues(self) -> bool:
        found = self.document.result
        return not (found is None or self.document.is_outdated or found.solved.all())

    def start(self, from_current_field: bool) -> None:
        self.parts.sequence_match.start(self.document, partial(self._take, False))

    def recover(self) -> None:
        """Show the fields that an earlier run stored in its checkpoint, without solving."""
        then = partial(self._take, True)
        self.parts.sequence_match.start(self.document, then, resumes_only=True)

    def follow(self) -> None:
        self.parts.functions.waiting_since = None

    def next_time(self, elapsed: float) -> float:
        document = self.document
        start, duration = document.start, document.end - document.start
        seconds = document.sequence.intervals / FRAMES_A_SECOND
        shown = document.time - start
        time = self.parts.player.advance(shown, elapsed, duration, duration, seconds)
        return min(start + time, document.end)

    def _take(
        self, is_recovery: bool, began: SequenceDocument, found: abfm.Sequence | None
    ) -> None:
        parts, solver = self.parts, self.parts.solver
        if found is None:
            again = {"Try again": partial(self._start, False)}
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
        if count:  # otherwise the earlier result stays
            view = replace(self.document, result=found).view_of_result(parts.view)
            parts.editor.change("match all frames", result=found, view=view)
            if view.flow_after_match:
                parts.editor.amend(time=self.document.start)
                parts.player.play_once()
        if count < len(found):
            parts.notices.show(_cancelled_text(count, len(found), earlier))


def _cancelled_text(count: int, total: int, earlier: abfm.Sequence | None) -> str:
    text = f"cancelled: {count} of {counted(total, 'interval')} found"
    if earlier is None or not earlier.solved.any():
        return text
    if not count:
        return f"{text}; the earlier result is kept"
    earlier_count = int(earlier.solved.sum())
    undo = f"Undo ({hint('undo')})"
    return f"{text}; {undo} restores the earlier result, which has {earlier_count} of them"

"""The session of a window: a document, and all that is computed for it before each drawing."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal
from weakref import WeakKeyDictionary

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm.workers import progress
from abfm.workers.progress import progress_text
from abfm_viewer.computing.matching import Snapshot
from abfm_viewer.document.document import SIDES, Channel, Document, Identity, Point, Side, Surface
from abfm_viewer.document.kinds import (
    MatchDocument,
    PairDocument,
    SequenceDocument,
    SubjectDocument,
    document_on,
)
from abfm_viewer.document.rescaling import rescaled, smoothed
from abfm_viewer.files.project import Origin
from abfm_viewer.session.editor import Step
from abfm_viewer.session.notices import RUN
from abfm_viewer.session.parts import Parts
from abfm_viewer.session.work import MatchRun, MatchWork, PairWork, SequenceWork, Work


class Session(Parts):
    """A document, its history for undo, and the computations for it, without any drawing.

    ``name`` is the name of the mesh's file. With ``at_once``, requests are computed immediately in
    the thread of the caller. Off-screen pictures need this, because they are drawn only once.
    """

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool = False) -> None:
        super().__init__(mesh, name, at_once)
        # sources that new documents adopt from the previous document
        self._sources: WeakKeyDictionary[Identity, str] = WeakKeyDictionary()
        self._run = MatchRun(self, self.match)
        match, self._sequence_document = MatchWork(self, self._run), SequenceWork(self, self.match)
        self._work: dict[type[Document], Work] = {
            MatchDocument: match,
            SubjectDocument: match,
            PairDocument: PairWork(self, self._run),
            SequenceDocument: self._sequence_document,
        }
        self._needed: tuple[object, ...] = ()
        # the document whose match starts when its initial map is found, and from which field
        self._waiting: tuple[Identity, bool] | None = None
        self._last_update = clock.perf_counter()

    @property
    def work(self) -> Work:
        return self._work[type(self.document)]

    def surface(self, slot: str = "advected") -> Surface:
        return self.document.surface(slot)

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self.document.channels

    @property
    def active(self) -> Channel | None:
        return self.document.active

    @property
    def parameters(self) -> Parameters:
        return self.document.parameters

    @property
    def result(self) -> abfm.Match | None:
        return self.document.match

    @property
    def time(self) -> float:
        """Shown time, relative to the start of the shown flow (of the interval, in a sequence)."""
        return self.document.flow_time

    def set_time(self, time: float) -> None:
        self.player.playing = False
        self.editor.set_time(time)

    def show_step(self, step: int) -> None:
        """Show a step of the result's continuation; cancel a search for less distortion."""
        self.bound.stop()
        self.steps.show(step)

    def limit_distortion(self) -> None:
        self.steps.stop()
        self.bound.start()

    def _stop_changes(self) -> None:
        """Cancel requests that would replace the result: for a step, or for less distortion."""
        self.steps.stop()
        self.bound.stop()

    def undo(self) -> None:
        """Undo the last change, unless this would close the document whose run is in progress."""
        self._step(self.editor.undo, self.editor.past)

    def redo(self) -> None:
        self._step(self.editor.redo, self.editor.future)

    def _step(self, move: Callable[[], None], steps: list[Step]) -> None:
        self.player.playing = False
        self._stop_changes()
        before = self.document
        if steps and steps[-1].document.identity is not before.identity:
            if self.solver.running:
                text = f"Undo and Redo would close {before.name}, which is being matched"
                self.notices.show(f"{text}; cancel the run first", True, RUN)
                return
            self.saves.leave(before)
        move()

    def set_mesh(self, mesh: TriangleMesh, name: str) -> None:
        """Show another mesh with default functions, parameters and view."""
        self.set_surfaces(Surface(mesh, name))
        self.notices.show(" ".join(mesh.messages))

    def set_surfaces(self, *surfaces: Surface) -> None:
        """Show a document with one surface, or with two that are registered, A to B.

        If the first surface is the same as before, the new document keeps parameters, view, and the
        first source. It also keeps the labels and landmarks on that surface.
        """
        fresh = document_on(surfaces, view=self.view.preferences)
        if surfaces[0].mesh is self.surface("source").mesh:
            halves = tuple(replace(one, target=None) for one in self.document.landmarks)
            fresh = replace(
                fresh,
                parameters=self.parameters,
                view=replace(self.view, viewpoint=None, enlarged=""),
                labels=self.document.labels,
                landmarks=tuple(half for half in halves if half.source is not None),
            )
            if self.channels:
                self._sources[fresh.identity] = self.channels[0].source
        self._go_to(fresh, None, saved=True)

    def restore(
        self,
        document: Document,
        known: dict[str, FloatArray],
        origin: Origin | None,
        saved: bool = True,
    ) -> None:
        """Show an opened document; a run of the previous document is cancelled.

        ``known`` are the values (V,) of functions from files, by `Document.values_key`. ``origin``
        is the project file, which Save overwrites. ``saved`` is False if there are unsaved changes,
        as after a crash.
        """
        for side in SIDES[-len(document.surfaces) :]:
            self.functions.add(document.surface(side).mesh, document.values_on(side, known))
        self._go_to(document, origin, saved)

    def _go_to(self, document: Document, origin: Origin | None, saved: bool) -> None:
        self.solver.cancel()
        if not self.solver.running:
            self.solver.forget()
        self.sequence_match.pair = None
        self.saves.leave(self.document)
        self.player.playing = False
        view = document.view.with_appearance(**self.view.appearance)
        if view is not document.view:
            document = replace(document, view=view)
        name = origin.path.name if origin else document.name
        self.editor.go_to(document, f"open {name}")
        self.saves.record(document, origin, saved=saved)

    def set_appearance(self, **values: Any) -> None:
        """Set the theme or the UI scale, by its name."""
        self.editor.amend(view=replace(self.view, **values))

    def reset_history(self) -> None:
        """Clear undo and redo, so that the current document is the first one of the history."""
        self.editor.forget_steps()
        self.saves.reset()

    def values(self, side: Side) -> FloatArray | None:
        """Return the active channel's source or target, (V,), on its own surface; None if unknown.

        For a sequence, source and target are the frames before and after the shown time.
        """
        return self.work.values(side)

    @property
    def busy(self) -> str:
        """Background computation in progress, except a run, with its time if known; or ""."""
        if self.loading.now:
            return progress_text("opening", self.loading.step)
        busy = self.work.busy or self.bound.busy
        return progress_text(busy, self.step) if busy else self.steps.busy

    @property
    def step(self) -> progress.Step | None:
        return self.work.step or self.bound.step

    @property
    def obstacle(self) -> str:
        """Reason why a match cannot start; empty if it can."""
        return self.work.obstacle

    @property
    def outdated(self) -> bool:
        return self.work.outdated

    @property
    def snapshot(self) -> Snapshot | None:
        return self._run.snapshot

    def place_point(self, kind: Literal["lines", "points"], slot: str, point: Point) -> None:
        """Add a start of a flow line, or a point that follows the flow, at a click in a slot."""
        if (placed := self.work.on_flow(slot, point)) is not None:
            points = *getattr(self.document, kind), placed
            self.editor.change("place a point", "", **{kind: points})

    @property
    def can_match(self) -> bool:
        return not (self.solver.running or self.obstacle or self.loading.replacing)

    @property
    def can_match_otherwise(self) -> bool:
        return self.can_match and self.result is not None

    @property
    def match_label(self) -> str:
        """Name of the usual next run: Match, Match again or Continue."""
        if self.work.continues:
            return "Continue"
        has_result = self.result is not None
        return "Match again" if has_result else self.document.match_label

    @property
    def other_match_label(self) -> str:
        """Name of the run with the other start than that of `match_label`."""
        return "Match from zero" if self.work.continues else "Continue from the current field"

    def match(self, from_current_field: bool = False) -> None:
        """Start a run of the solver, unless one is running; if it cannot start, show the reason.

        If ``from_current_field``, the run starts from the field of the result, otherwise from zero.
        Placing of landmarks stops, and the run starts when the initial map by them is found.
        """
        if self.solver.running:
            return
        if self.view.tool == "landmark":
            self.editor.switch_placing()
            if self.obstacle and not self.work.blocking_problem:
                self._waiting = self.document.identity, from_current_field
                self.notices.show("the match starts when the initial map is found")
                return
        if opening := self.loading.replacing:
            text = f"no match yet: {opening}, which will replace {self.document.name}"
            self.notices.show(text)
            return
        if self.obstacle:
            self.notices.show(
                f"no match yet: {self.obstacle}", self.work.blocking_problem != "", RUN
            )
            return
        self.notices.clear()
        self.notices.resolve(RUN)
        self._stop_changes()
        self.work.start(from_current_field)

    def recover_sequence(self) -> None:
        """Show the fields that an earlier run of the sequence stored, unless a run is active."""
        if not self.solver.running:
            self._sequence_document.recover()

    def remedy(self, remedy: abfm.matching.Remedy) -> None:
        """Apply a remedy that a verdict suggests: change parameters of the match, and start a run.

        The change and the result are one step of undo. If the changed parameters are not allowed
        together with the others, a `ParameterError` is raised.
        """
        may_start = not (self.solver.running or self.obstacle or self.loading.replacing)
        if may_start:
            self.editor.set_parameter(label=remedy.label.lower(), **remedy.parameters)
        self.match(remedy.starts_from_field)
        if may_start and remedy.parameters:
            self._run.remedy_action = self.editor.action_count

    def switch_flow_after_match(self) -> None:
        """Switch showing the flow after matches on or off; off also hides the shown flow."""
        if self.view.flow_after_match:
            self.player.playing = False
            label = "hide the flow after matches"
            self.editor.set_view(label, flow_after_match=False, arrows=False, streaks=False)
        else:
            self._run.shown_flow_of = None
            self.editor.set_view("show the flow after matches", flow_after_match=True)

    def update(self) -> None:
        """Collect background results and update all parts; called before each drawing."""
        now = clock.perf_counter()
        elapsed, self._last_update = now - self._last_update, now
        self.loading.update()
        self.notices.update()
        self.steps.update()
        self.bound.update()
        self._find_defaults()
        self.work.follow()
        self._match_when_possible()
        if self.view.animate:
            self.player.move_streaks(elapsed)
        if self.player.playing:
            self.editor.amend(time=self.work.next_time(elapsed))
        self.solver.collect()
        self._release_unused()

    def _match_when_possible(self) -> None:
        if self._waiting is None:
            return
        identity, from_current_field = self._waiting
        if identity is not self.document.identity or self.view.tool == "landmark":
            self._waiting = None
        elif not self.obstacle or self.work.blocking_problem:
            self._waiting = None
            self.match(from_current_field)

    def _release_unused(self) -> None:
        """Free the memory of meshes that undo, unsaved documents and the run do not need."""
        run = self._run.document if self.matching.running else self.document
        now = (self.document.identity, run.identity, self.editor.action_count)
        if now == self._needed:
            return
        self._needed = now
        in_history = self.editor.documents
        self.saves.forget_all_but({document.identity for document in in_history})
        in_use = _meshes(self.document, run)
        retained = in_use | _meshes(*in_history, *self.saves.unsaved_documents)
        self.functions.release_unused(in_use, retained)

    def scaled_channels(self, side: Side) -> tuple[Channel, ...]:
        """Return the channels with one side scaled and shifted to the range of the other.

        The range of a target is measured where the mask is above 0. Functions that cannot be scaled
        stay the same, and so do all if a match standardizes their values.
        """
        document = self.document
        assert isinstance(document, MatchDocument)
        if self.work.flow_values("target") is not self.values("target"):
            return document.channels
        mask = self.functions.values(document.mask_function) if document.mask else None
        found = []
        for channel in document.channels:
            values = [self.functions.values(document.function(each, channel)) for each in SIDES]
            source, target = values
            spec = channel.spec(side)
            if source is not None and target is not None:
                pair = source, target if mask is None else target[mask > 0]
                spec = rescaled(spec, *(pair if side == "source" else pair[::-1]))
            found.append(channel.changed(side, spec))
        return tuple(found)

    def scale(self, side: Side) -> None:
        self.editor.change(f"scale the {side}", channels=self.scaled_channels(side))

    def smooth(self, number: int, length: float) -> None:
        """Smooth both functions of a channel over a length, in sqrt(area)."""
        channels = [*self.channels]
        for side in SIDES:
            channel = channels[number]
            channels[number] = channel.changed(side, smoothed(channel.spec(side), length))
        self.editor.change("smooth the functions", channels=tuple(channels))

    def _find_defaults(self) -> None:
        if self.channels:
            return
        found, problem = self.work.defaults()
        if found is not None:
            pristine = not self.saves.unsaved
            source = self._sources.get(self.document.identity, found[0])
            self.editor.amend(channels=(Channel(source, found[1]),))
            if pristine:
                self.saves.record(self.document, self.saves.origin(self.document))
        elif problem:
            self.editor.amend(channels=(Channel("coordinate:x", "coordinate:y"),))
            self.notices.show(f"no default functions: {problem}", is_error=True)


def _meshes(*documents: Document) -> set[TriangleMesh]:
    return {surface.mesh for document in documents for surface in document.surfaces}

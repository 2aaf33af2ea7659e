"""A document at work: its parts, and what they give, taken in once a frame."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from typing import Literal
from weakref import WeakKeyDictionary

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm.workers import progress
from abfm.workers.progress import progress_text
from abfm_viewer.computing.matching import Snapshot
from abfm_viewer.document.document import (
    SIDES,
    Channel,
    Document,
    Identity,
    Point,
    Side,
    Surface,
)
from abfm_viewer.document.kinds import (
    MatchDocument,
    PairDocument,
    SequenceDocument,
    SubjectDocument,
    document_on,
)
from abfm_viewer.document.rescaling import rescaled
from abfm_viewer.files.project import Origin
from abfm_viewer.session.editor import Step
from abfm_viewer.session.notices import RUN
from abfm_viewer.session.parts import Parts
from abfm_viewer.session.work import MatchRun, MatchWork, PairWork, SequenceWork, Work


class Session(Parts):
    """One document at work. Knows nothing of the window, nor of pictures.

    If `at_once`, everything is computed when it is asked for, as pictures off the screen need,
    which wait for no frame. While the mouse is `dragging` a widget or a Gaussian, changes are one
    step of undo. Whether the machine `draws_quickly` the window says.
    """

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool = False) -> None:
        super().__init__(mesh, name, at_once)
        # of documents that began with one of another
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
        self._last_update = clock.perf_counter()

    @property
    def work(self) -> Work:
        """What is done with documents of the present one's kind."""
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
        """The document's match, if it has one."""
        return self.document.match

    @property
    def time(self) -> float:
        """The shown time in the flow that is shown."""
        return self.document.flow_time

    def set_time(self, time: float) -> None:
        self.player.playing = False
        self.editor.set_time(time)

    def show_step(self, step: int) -> None:
        """Show another step of the result's path, whatever was to take its place."""
        self.bound.stop()
        self.steps.show(step)

    def limit_distortion(self) -> None:
        """Look for the closest field within the bound of distortion."""
        self.steps.stop()
        self.bound.start()

    def _stop_changes(self) -> None:
        """Let no step or bounded field that was requested before take the result's place."""
        self.steps.stop()
        self.bound.stop()

    def undo(self) -> None:
        """Take back the last step, but no run that is under way; what plays stops."""
        self._step(self.editor.undo, self.editor.past)

    def redo(self) -> None:
        """Do again what was taken back, but end no run that is under way; what plays stops."""
        self._step(self.editor.redo, self.editor.future)

    def _step(self, go: Callable[[], None], to: list[Step]) -> None:
        self.player.playing = False
        self._stop_changes()
        before = self.document
        if to and to[-1].document.identity is not before.identity:
            if self.solver.running:
                text = f"that would leave {before.name}, which is being matched"
                self.notices.show(f"{text}: cancel the run first", True, RUN)
                return
            self.saves.leave(before)
        go()

    def set_mesh(self, mesh: TriangleMesh, name: str) -> None:
        """Show another mesh with default functions, parameters and view."""
        self.set_surfaces(Surface(mesh, name))
        self.notices.show(" ".join(mesh.messages))

    def set_surfaces(self, *surfaces: Surface) -> None:
        """Register surface A to another one, B, or go back to one. If A is the present one, the
        first source, labels and landmarks of A, parameters and the view stay.
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
        """Show an opened document with values of functions from files, and end a run.

        Save writes the document's project file, the `origin`, if it has one. One that was not
        `saved`, as after a crash, is asked for at the end like the user's own work.
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
        name = origin.path.name if origin else document.name
        self.editor.go_to(document, f"open {name}")
        self.saves.record(document, origin, saved=saved)

    def reset_history(self) -> None:
        """Forget all steps: the present state is where the user starts."""
        self.editor.forget_steps()
        self.saves.reset()

    def values(self, side: Side) -> FloatArray | None:
        """The active channel's function of a side on its surface, (V,), if it is known; of a film
        the frame before or after the shown time.
        """
        return self.work.values(side)

    @property
    def busy(self) -> str:
        """Say what it computes in the background besides the solver, and for how long if known."""
        if self.loading.now:
            return progress_text("opening", self.loading.step)
        busy = self.work.busy or self.bound.busy
        return progress_text(busy, self.step) if busy else self.steps.busy

    @property
    def step(self) -> progress.Step | None:
        return self.work.step or self.bound.step

    @property
    def obstacle(self) -> str:
        """Say why a match cannot start; nothing if it can."""
        return self.work.obstacle

    @property
    def outdated(self) -> bool:
        return self.work.outdated

    @property
    def snapshot(self) -> Snapshot | None:
        return self._run.snapshot

    def place_point(self, kind: Literal["lines", "points"], slot: str, point: Point) -> None:
        """Place a point where it was clicked on; one on A where the initial map takes it on B."""
        if (placed := self.work.on_flow(slot, point)) is not None:
            self.editor.add_point(kind, placed)

    def match(self, from_current_field: bool | None = None) -> None:
        """Start a run, unless one is under way; if there is nothing to match yet, say why.

        By default `from_current_field` is the switch of the panel Match.
        """
        if self.solver.running:
            return
        if opening := self.loading.replacing:
            text = f"no match yet: {opening}; it takes the place of {self.document.name}"
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
        """Show what an earlier run of the film has found, unless a run is under way."""
        if not self.solver.running:
            self._sequence_document.recover()

    def remedy(self, remedy: abfm.matching.Remedy) -> None:
        """Do what a verdict proposes: change the parameters, and start a run.

        With its result it is one step of undo. ParameterError if the document's other parameters do
        not allow it.
        """
        may_start = not (self.solver.running or self.obstacle or self.loading.replacing)
        if may_start:
            self.editor.set_parameter(label=remedy.label.lower(), **remedy.parameters)
        self.match(remedy.goes_on)
        if may_start and remedy.parameters:
            self._run.remedied = self.editor.action_count

    def switch_flow_after_match(self) -> None:
        """Show the flow after the next match, or neither after that nor now."""
        if self.view.flow_after_match:
            self.player.playing = False
            label = "hide the flow after matches"
            self.editor.set_view(label, flow_after_match=False, arrows=False, streaks=False)
        else:
            self._run.flow_seen = None
            self.editor.set_view("show the flow after matches", flow_after_match=True)

    def update(self) -> None:
        """Take in what happened since the last frame: call once per frame, before drawing."""
        now = clock.perf_counter()
        elapsed, self._last_update = now - self._last_update, now
        self.loading.update()
        self.notices.update()
        self.steps.update()
        self.bound.update()
        self._find_defaults()
        self.work.follow()
        if self.view.animate:
            self.player.move_streaks(elapsed)
        if self.player.playing:
            self.editor.amend(time=self.work.next_time(elapsed))
        self.solver.collect()
        self._keep_what_is_needed()

    def _keep_what_is_needed(self) -> None:
        """Keep of other documents only what undo, unsaved work and a run that ends still need."""
        run = self._run.began if self.matching.running else self.document
        now = (self.document.identity, run.identity, self.editor.action_count)
        if now == self._needed:
            return
        self._needed = now
        in_history = self.editor.documents
        self.saves.forget_all_but({document.identity for document in in_history})
        at_work = _meshes(self.document, run)
        in_reach = at_work | _meshes(*in_history, *self.saves.unsaved_documents)
        self.functions.keep(at_work, in_reach)

    def rescaled_channels(self) -> tuple[Channel, ...]:
        """Return the channels with sources that have the range of their targets, where these have
        values; the present ones if nothing can be scaled.
        """
        document = self.document
        assert isinstance(document, MatchDocument)
        mask = self.functions.values(document.mask_function) if document.mask else None
        found = []
        for channel in document.channels:
            values = [self.functions.values(document.function(side, channel)) for side in SIDES]
            source, target = values
            if target is not None and mask is not None:
                target = target[mask > 0]
            spec = channel.source
            if source is not None and target is not None:
                spec = rescaled(spec, source, target)
            found.append(channel.changed("source", spec))
        return tuple(found)

    def rescale(self) -> None:
        """Scale and shift the sources to the ranges of their targets."""
        self.editor.change("rescale the source", channels=self.rescaled_channels())

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

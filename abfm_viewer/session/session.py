"""A document at work: its parts, and what they give, taken in once a frame."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal
from weakref import WeakKeyDictionary

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm.wording import counted
from abfm.workers import progress
from abfm.workers.progress import said
from abfm.workers.worker import Worker, stateless
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.computing.evaluation import Evaluators
from abfm_viewer.computing.solver import ProblemSpec, Snapshot, Solver
from abfm_viewer.document.document import (
    SIDES,
    Channel,
    Document,
    Identity,
    Point,
    Side,
    Surface,
    View,
)
from abfm_viewer.document.rescaling import rescaled
from abfm_viewer.document.surface_points import points_of, surface_points
from abfm_viewer.files.project import Origin
from abfm_viewer.session.bound import Bound
from abfm_viewer.session.editor import Editor, Step
from abfm_viewer.session.film_files import view_of_fields
from abfm_viewer.session.film_match import FilmMatch
from abfm_viewer.session.functions import DocumentFunctions
from abfm_viewer.session.initial_maps import InitialMaps, Prepared
from abfm_viewer.session.loading import Loading
from abfm_viewer.session.notices import Notices, WaysOut
from abfm_viewer.session.path_steps import PathSteps
from abfm_viewer.session.player import FRAMES_A_SECOND, Player
from abfm_viewer.session.saves import Saves

RUN = "run"
"""What cards about a match are about."""
_ENDED = "the process that computes has ended; try again"
_MOST_FACES = 50_000  # of a mesh that gets streaks after a match: within two seconds


class Session:
    """One document at work. Knows nothing of the window, nor of pictures.

    If `at_once`, everything is computed when it is asked for, as pictures off the screen need,
    which wait for no frame. While the mouse is `dragging` a widget or a Gaussian, changes are one
    step of undo. Whether the machine `draws_quickly` the window says.
    """

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool = False) -> None:
        self._jobs = Jobs(at_once)
        self.at_once = at_once
        self.editor = Editor(Document((Surface(mesh, name),)))
        self.functions = DocumentFunctions(self._jobs)
        # for what holds the interpreter for long
        self._apart = None if at_once else Worker(stateless, _ENDED)
        self.initial_maps = InitialMaps(self._jobs, self.functions, self._apart)
        self.notices = Notices(lambda: self.editor.moves)
        self.loading = Loading(self._jobs, self.notices)
        self.saves = Saves(self.editor)
        self.steps = PathSteps(self.editor, self._jobs, self.notices)
        self.bound = Bound(self.editor, self._jobs, self.notices, at_once)
        self.solver = Solver()
        self.film_match = FilmMatch()
        self.player = Player()
        self.dragging = self.draws_quickly = False
        # of documents that began with one of another
        self._sources: WeakKeyDictionary[Identity, str] = WeakKeyDictionary()
        self._coarse_meshes: Latest[None] = self._jobs.latest()
        self._registration: Memo[abfm.Registration] = Memo()
        self._facts: Latest[abfm.Facts] = self._jobs.latest()
        self._foreseen: Latest[abfm.Facts | None] = self._jobs.latest()
        self._flow_seen: Identity | None = None  # of a document whose flow was shown
        self._run_began = self.document
        # moves of the history when a remedy began the run: its result belongs to that step
        self._remedied = -1
        self._needed: tuple[object, ...] = ()
        self._last_update = clock.perf_counter()

    @property
    def document(self) -> Document:
        return self.editor.document

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
    def view(self) -> View:
        return self.document.view

    @property
    def result(self) -> abfm.Match | None:
        return self.document.result

    @property
    def time(self) -> float:
        """The shown time in the flow that is shown: of a film since the frame before."""
        if (film := self.document.film) is None:
            return self.document.time
        return self.document.time - float(film.times[film.interval(self.document.time)])

    @property
    def tau(self) -> float:
        """How long the flow that is shown takes: of a film from frame to frame."""
        if (film := self.document.film) is None:
            return self.parameters.tau
        return float(film.frames.durations[film.interval(self.document.time)])

    @property
    def running(self) -> bool:
        return self.solver.running or self.film_match.running

    def cancel(self) -> None:
        """End the run with what it has found."""
        self.film_match.cancel()
        self.solver.cancel()

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
        self.bound.look()

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
            if self.running:
                text = f"that would leave {before.name}, which is being matched"
                self.notices.say(f"{text}: cancel the run first", True, RUN)
                return
            self.saves.leave(before)
        go()

    def set_mesh(self, mesh: TriangleMesh, name: str) -> None:
        """Show another mesh with default functions, parameters and view."""
        self.set_surfaces(Surface(mesh, name))
        self.notices.say(" ".join(mesh.messages))

    def set_surfaces(self, *surfaces: Surface) -> None:
        """Register surface A to another one, B, or go back to one. If A is the present one, the
        first source, labels and landmarks of A, parameters and the view stay.
        """
        fresh = Document(surfaces, view=self.view.preferences)
        if surfaces[0].mesh is self.surface("source").mesh:
            halves = tuple(replace(one, target=None) for one in self.document.landmarks)
            fresh = replace(
                fresh,
                parameters=self.parameters,
                view=replace(self.view, look=None, large=""),
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
            self.functions.add(document.surface(side).mesh, document.known_on(side, known))
        self._go_to(document, origin, saved)

    def _go_to(self, document: Document, origin: Origin | None, saved: bool) -> None:
        self.cancel()
        self.film_match.pair = None
        self.saves.leave(self.document)
        self.player.playing = False
        name = origin.path.name if origin else document.name
        self.editor.go_to(document, f"open {name}")
        self.saves.mark(document, origin, saved=saved)

    def reset_history(self) -> None:
        """Forget all steps: the present state is where the user starts."""
        self.editor.forget_steps()
        self.saves.reset()

    def functions_of(self, document: Document) -> Evaluators:
        return self.functions.of_document(document)

    def values(self, side: Side) -> FloatArray | None:
        """The active channel's function of a side on its surface, (V,), if it is known; of a film
        the frame before or after the shown time.
        """
        if (film := self.document.film) is not None:
            frame = film.interval(self.document.time) + (side == "target")
            return film.columns[frame][self.document.channel]
        return self.functions.values(self.document.function(side)) if self.active else None

    @property
    def prepared(self) -> Prepared | None:
        """What is matched on surface B of two, as far as it is known by now."""
        return self.initial_maps.prepared(self.document)

    @property
    def registration(self) -> abfm.Registration | None:
        """The result with the initial map that it began with, where there are two surfaces."""
        result, initial = self.document.result, self.document.initial_map
        if result is None or initial is None:
            return None
        return self._registration.get((result, initial), lambda: initial.registration(result))

    @property
    def facts(self) -> abfm.Facts | None:
        """What is reported of the result; of two surfaces those of the match on B, marked as
        incomplete, until the complete map is measured.
        """
        result, found = self.document.result, self.registration
        if result is None or found is None:
            return None if result is None else result.facts
        facts = self._facts.ask(found, lambda: found.facts)
        return facts or replace(result.facts, is_complete=False)

    def compared(self, side: Side) -> FloatArray | None:
        """The same as a flow carries or meets it, (V,), on B where there are two surfaces."""
        if not self.document.is_pair:
            return self.values(side)
        return self.initial_maps.compared(self.document, side) if self.active else None

    def error(self, of: Side | Literal["mask"]) -> str:
        """Say why the active channel's source or target, or the mask, has no values."""
        if of == "mask":
            return self.functions.error(self.document.mask_function)
        return self.functions.error(self.document.function(of)) if self.active else ""

    @property
    def busy(self) -> str:
        """Say what it computes in the background besides the solver, and for how long if known."""
        if self.loading.now:
            return said("opening", self.loading.step)
        busy = "" if self.document.film else self.functions.busy(self.document)
        if not busy and self.document.is_pair and self.initial_maps.busy:
            busy = "finding the initial map"
        busy = busy or self.bound.busy
        return said(busy, self.step) if busy else self.steps.busy

    @property
    def step(self) -> progress.Step | None:
        return self.functions.step(self.document) or self.initial_maps.step or self.bound.step

    @property
    def problem(self) -> ProblemSpec:
        document, prepared = self.document, self.prepared
        return ProblemSpec(
            self.surface().mesh,
            document.channels,
            document.parameters,
            document.mask,
            document.pairs,
            document.landmarks_alone,
            None if prepared is None else prepared.initial,
        )

    @property
    def obstacle(self) -> str:
        """Say why a match cannot start; nothing if it can."""
        if self.document.film is not None:
            return ""
        obstacle = self.functions.obstacle(self.document)
        if obstacle or not self.document.is_pair:
            return obstacle
        is_under_way = self.initial_maps.busy and not self.solver.running
        if self.prepared is None or is_under_way:
            return self.initial_maps.error or "the initial map is being found"
        return ""

    @property
    def problem_told(self) -> str:
        """Say what keeps a match from starting until the user does something about it."""
        told = self.functions.problem(self.document)
        if not told and self.document.is_pair and self.prepared is None:
            told = self.initial_maps.error
        return told

    @property
    def foreseen(self) -> abfm.Facts | None:
        """What is known of a match of the present functions before it is solved; None if nothing
        prevents it, or before that is known.
        """
        if self.document.film is not None or self.solver.running or self.obstacle:
            return None
        spec = replace(self.problem, parameters=Parameters(goal=self.parameters.goal))
        given = spec, self.functions_of(self.document)
        return self._foreseen.newest(spec.mesh, _foreseen, *given)

    @property
    def outdated(self) -> bool:
        return self.functions.outdated(self.document)

    @property
    def snapshot(self) -> Snapshot | None:
        is_of_run = self._run_began.identity is self.document.identity
        return self.solver.snapshot if is_of_run else None

    def place_point(self, kind: Literal["lines", "points"], slot: str, point: Point) -> None:
        """Place a point where it was clicked on; one on A where the initial map takes it on B."""
        document = self.document
        if document.is_pair and slot == "source":
            if (prepared := self.prepared) is None:
                self.notices.say("no point on A yet: there is no initial map that takes it to B")
                return
            on_a = surface_points(document.surface(slot).mesh, [point])
            [point] = points_of(prepared.initial.correspondence.carry_points(on_a))
        self.editor.add_point(kind, point)

    def match(self, goes_on: bool | None = None) -> None:
        """Start a run, unless one is under way; if there is nothing to match yet, say why.

        Unless it is given, the solver is set to whether it `goes_on` from the present field.
        """
        if self.running:
            return
        if opening := self.loading.replacing:
            text = f"no match yet: {opening}; it takes the place of {self.document.name}"
            self.notices.say(text)
            return
        if self.obstacle:
            self.notices.say(f"no match yet: {self.obstacle}", self.problem_told != "", RUN)
            return
        self.notices.clear()
        self.notices.mend(RUN)
        if self.document.film is not None:
            self.film_match.start(self.document)
            return
        self._take_usual_parameters()
        field, mesh = None, self.surface().mesh
        warm = self.solver.warm if goes_on is None else goes_on
        if warm and self.result is not None and self.result.mesh.digest == mesh.digest:
            field = self.result.start_for(self.parameters)
        self.player.playing = False
        self.editor.amend(time=self.parameters.tau)
        self._run_began, self._remedied = self.document, -1
        self._stop_changes()
        self.solver.start(self.problem, self.functions_of(self.document), field)

    def _take_usual_parameters(self) -> None:
        """Match functions of two surfaces as their kind is, unless the user set parameters."""
        usual = self.prepared.usual if self.prepared else None
        if usual is not None and usual != self.parameters == Parameters():
            label = "parameters for measured functions"
            self.editor.set_parameter(label=label, **usual.to_dict())
            self.notices.say(f"{label} were set, as the functions of A and B look measured")

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
            self._remedied = self.editor.moves

    def switch_flow_after_match(self) -> None:
        """Show the flow after the next match, or neither after that nor now."""
        if self.view.flow_after_match:
            self.player.playing = False
            label = "hide the flow after matches"
            self.editor.set_view(label, flow_after_match=False, arrows=False, streaks=False)
        else:
            self._flow_seen = None
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
        self.functions.update(self.document)
        # the functions come first, and pictures off the screen solve nothing
        if not (self.obstacle or self.at_once or self.document.film):
            # a match that begins earlier waits for its coarse meshes
            mesh, parameters = self.surface().mesh, self.parameters
            prepare = partial(self.solver.prepare, mesh, parameters)
            self._coarse_meshes.ask((mesh, parameters.solver.levels), prepare)
        if self.dragging or not self.obstacle:  # what cannot be evaluated must not end a run
            self.solver.follow_problem(self.problem, self.dragging)
        if self.view.animate:
            self.player.move_streaks(elapsed)
        if self.player.playing:
            self._play(elapsed)
        self._collect()
        self._collect_film()
        self._keep_what_is_needed()

    def _play(self, elapsed: float) -> None:
        document, film = self.document, self.document.film
        if film is None:
            tau, end = self.parameters.tau, document.end
            self.editor.amend(time=self.player.advance(self.time, elapsed, tau, end))
            return
        start, whole = document.start, document.end - document.start
        seconds = film.intervals / FRAMES_A_SECOND
        time = self.player.advance(document.time - start, elapsed, whole, whole, seconds)
        self.editor.amend(time=min(start + time, document.end))

    def _collect_film(self) -> None:
        """Take in a film's fields when its run has ended."""
        if (ended := self.film_match.collect()) is None:
            return
        began, found, was_recovered = ended
        if isinstance(found, str):
            self.notices.say(f"the solver stopped: {found}", True, RUN, {"Try again": self.match})
            return
        count = int(found.solved.sum())
        if self.document.identity is not began.identity:
            if count:
                self.saves.found(replace(began, sequence=found))
            return
        if was_recovered:
            if count:
                self.editor.amend(sequence=found)
            return
        earlier = self.document.sequence
        if count:  # else nothing takes the place of what there is
            view = view_of_fields(self.view, found)
            self.editor.change("match all frames", sequence=found, view=view)
            if view.flow_after_match:
                self.editor.amend(time=self.document.start)
                self.player.play_once()
        if count < len(found):
            self.notices.say(_broken_off(count, len(found), earlier))

    def _keep_what_is_needed(self) -> None:
        """Keep of other documents only what undo, unsaved work and a run that ends still need."""
        run = self._run_began if self.solver.running else self.document
        now = (self.document.identity, run.identity, self.editor.moves)
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
        if self.channels or self.document.film is not None:
            return
        found, problem = self.functions.defaults(self.document)
        if found is not None:
            pristine = not self.saves.unsaved
            source = self._sources.get(self.document.identity, found[0])
            self.editor.amend(channels=(Channel(source, found[1]),))
            if pristine:
                self.saves.mark(self.document, self.saves.origin(self.document))
        elif problem:
            self.editor.amend(channels=(Channel("coordinate:x", "coordinate:y"),))
            self.notices.say(f"no default functions: {problem}", is_error=True)

    def _collect(self) -> None:
        if (ended := self.solver.collect()) is None:
            return
        match, run, solved = ended
        self.notices.mend(RUN)
        failed = self.solver.failed
        replaced = self._run_began.identity is not self.document.identity
        document = self._run_began if replaced else self.document
        self._run_began = self.document
        runs = document.runs if run is None else (*document.runs, run)
        outcome: dict[str, Any] = {"result": match, "runs": runs, "chosen": None}
        outcome["initial_map"] = solved.initial
        if match is not None:
            self.saves.found(replace(document, **outcome))
        if replaced:
            self.solver.forget()
            return
        again: WaysOut = {"Try again": self.match}
        if match is not None:  # the newest field that was known
            again = {
                "Continue": partial(self.match, True),
                "Match again": partial(self.match, False),
            }
            self._show(match, outcome)
        if failed:
            self.notices.say(f"the solver stopped: {self.solver.reason}", True, RUN, again)

    def _show(self, match: abfm.Match, outcome: dict[str, Any]) -> None:
        view = None
        if not (self.solver.failed or self.at_once or self.dragging):
            view = self._view_of_flow(match)
        outcome["view"] = view or self.view
        if self._remedied == self.editor.moves:
            self.editor.amend(**outcome)
        else:
            self.editor.change("match", **outcome)
        if view is not None:
            self.editor.amend(time=0.0)
            self.player.play_once()

    def _view_of_flow(self, match: abfm.Match) -> View | None:
        """The view of the flow after a match; None where there is nothing to play.

        Streaks where there is time for them, else arrows. The flow is left as the user has it if it
        is shown already, or is shown as something else than the function; and where the user hid it
        after an earlier match of this document, it stays hidden.
        """
        view, document = self.view, self.document
        if not view.flow_after_match or not match.velocity.any():
            return None
        known, self._flow_seen = self._flow_seen is document.identity, document.identity
        if known or view.arrows or view.streaks or view.coloring != "function":
            return view
        streaks = self.draws_quickly and len(match.mesh.faces) <= _MOST_FACES
        return replace(view, streaks=streaks, arrows=not streaks)

    def close(self) -> None:
        self.solver.close()
        self.film_match.close()
        self.functions.close()
        self.bound.close()
        if self._apart is not None:
            self._apart.close()
        self._jobs.close()


def _foreseen(spec: ProblemSpec, functions: Evaluators) -> abfm.Facts | None:
    return abfm.matching.foreseen(spec.problem(functions))


def _broken_off(count: int, whole: int, earlier: abfm.Sequence | None) -> str:
    """Say what a film's run that was cancelled has found, and where its earlier result is."""
    told = f"cancelled: {count} of {counted(whole, 'interval')} found"
    if earlier is None or not earlier.solved.any():
        return told
    if not count:
        return f"{told}, the earlier result stays"
    more = int(earlier.solved.sum())
    return f"{told}; Undo (Ctrl+Z) brings back the earlier result, which has {more}"


def _meshes(*documents: Document) -> set[TriangleMesh]:
    return {surface.mesh for document in documents for surface in document.surfaces}

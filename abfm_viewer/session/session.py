"""A document at work: its functions, its solver, and what they give, taken in once a frame."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from abfm import TriangleMesh
from abfm.progress import Step, said
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.computing.evaluation import Evaluated, Functions
from abfm_viewer.computing.memo import same
from abfm_viewer.computing.problem import Problem
from abfm_viewer.computing.solver import Solver
from abfm_viewer.document.document import Channel, Document, Side
from abfm_viewer.document.history import History
from abfm_viewer.files.origin import Origin
from abfm_viewer.session.after_match import AfterMatch
from abfm_viewer.session.housekeeping import RUN, Housekeeping
from abfm_viewer.session.kept import Kept
from abfm_viewer.session.mesh_functions import MeshFunctions
from abfm_viewer.session.notices import WaysOut
from abfm_viewer.session.obstacle import obstacle
from abfm_viewer.session.outdated import Outdated
from abfm_viewer.session.player import Player

if TYPE_CHECKING:
    from abfm.matching import Remedy


class Session(Housekeeping):
    """One document, its history, its solver and its player. Knows nothing of the window, nor of pictures.

    If `at_once`, everything is computed when it is asked for, as pictures off the screen need, which wait for no frame.
    While the mouse is `dragging` a widget or a Gaussian, changes are one step of undo. `bare_since` is the time, by
    `time.perf_counter`, from which on the mesh has waited for its first functions; None if it has some.
    """

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool = False) -> None:
        self._jobs = Jobs(at_once)
        super().__init__(Document(mesh, name), self._jobs)
        self.at_once = at_once
        self.solver = Solver()
        self.player = Player()
        self.after_match = AfterMatch()
        self.dragging = False
        self.bare_since: float | None = None
        self._functions = MeshFunctions(at_once)
        self._minded: tuple[object, ...] = ()
        self._evaluated = Evaluated()
        self._evaluated_by: Functions | None = None
        self._defaults: Latest[tuple[str, str]] = self._jobs.latest("default functions")
        self._coarse_meshes: Latest[None] = self._jobs.latest("coarse meshes")
        self._outdated = Outdated()
        self._run_began = self.document
        self._remedied = -1  # moves of the history when a remedy began the run: its result belongs to that step
        self._last_update = clock.perf_counter()

    def set_time(self, time: float) -> None:
        """Show another time of the time bar; what plays stops."""
        self.player.playing = False
        super().set_time(time)

    def undo(self) -> None:
        """Take back the last step, but no run that is under way; what plays stops."""
        self._step(self.history.undo, self.history.undo_to)

    def redo(self) -> None:
        """Do again what was taken back, but end no run that is under way; what plays stops."""
        self._step(self.history.redo, self.history.redo_to)

    def _step(self, go: Callable[[], None], to: Document | None) -> None:
        self.player.playing = False
        before = self.document
        if to is not None and to.mesh is not before.mesh:
            if self.solver.running:
                self.say(f"that would leave {before.name}, which is being matched: cancel the run first", True, RUN)
                return
            self._kept.leave(before)
        go()

    # Meshes and results

    def set_mesh(self, mesh: TriangleMesh, name: str) -> None:
        """Show another mesh with default functions; the parameters stay."""
        view = replace(self.view, look=None, front=None, large="")
        fresh = Document(mesh, name, parameters=self.parameters, view=view)
        self.restore(fresh, {}, None)
        self.say(" ".join(mesh.messages))

    def restore(
        self, document: Document, known: dict[str, FloatArray], origin: Origin | None, saved: bool = True
    ) -> None:
        """Show an opened document, and end a run; `known` are values of functions from files (see `Functions`).

        Save writes its project file, the `origin`, if it has one. One that was not `saved`, as after a crash, is asked
        for at the end like the user's own work.
        """
        self.solver.cancel()
        self._kept.leave(self.document)
        self.player.playing = False
        self._functions.add(document.mesh, known)
        self.history.change(document, f"open {origin.path.name if origin else document.name}")
        self._kept.keep(document, origin) if saved else self._kept.recover(document.mesh, origin)

    def reset_history(self) -> None:
        """Forget all steps: the present state is where the user starts."""
        origin, self.history = self._kept.origin(self.mesh), History(self.document)
        self._kept = Kept(self.document)
        self._kept.keep(self.document, origin)

    # The solver

    @property
    def functions(self) -> Functions:
        """Values of functions on the mesh."""
        return self.functions_of(self.mesh)

    def functions_of(self, mesh: TriangleMesh) -> Functions:
        """Values of functions on a mesh of the history."""
        return self._functions.of(mesh)

    @property
    def problem(self) -> Problem:
        """What Match would solve now."""
        return Problem(self.mesh, self.channels, self.parameters, self.document.mask)

    @property
    def obstacle(self) -> str:
        """Why a match cannot start now; empty if it can."""
        return obstacle(self.document, self.specs, self._evaluated)

    def match(self, goes_on: bool | None = None) -> None:
        """Start a run, unless one is under way; if there is nothing to match yet, say why.

        Whether it `goes_on` from the present field is what the solver is set to, unless it is given.
        """
        if self.solver.running:
            return
        if self.opening:
            self.say(f"no match yet: {self.opening}; it takes the place of {self.document.name}")
            return
        if self.obstacle:
            self.say(f"no match yet: {self.obstacle}", bool(self._evaluated.errors), RUN)
            return
        field = None
        warm = self.solver.warm if goes_on is None else goes_on
        if warm and self.result is not None and self.result.mesh is self.mesh:
            field = self.result.start_for(self.parameters)
        self._notices.clear()
        self._notices.mend(RUN)
        self.player.playing = False
        self.amend(time=self.parameters.tau)
        self._run_began = self.document
        self._remedied = -1
        self.solver.start(self.problem, self.functions, field)

    def remedy(self, remedy: Remedy) -> None:
        """Do what a verdict proposes: change the parameters, and start a run. With its result it is one step of undo.

        ParameterError if the document's other parameters do not allow it.
        """
        may_start = not (self.solver.running or self.obstacle or self.opening)
        if may_start:
            self.set_parameter(label=remedy.label.lower(), **remedy.parameters)
        self.match(remedy.goes_on)
        if may_start and remedy.parameters:
            self._remedied = self.history.moves

    def switch_flow_after_match(self) -> None:
        """Show the flow after the next match, or neither after that nor now."""
        if self.view.flow_after_match:
            self.player.playing = False
            self.set_view("hide the flow after matches", flow_after_match=False, arrows=False, streaks=False)
        else:
            self.after_match.forget()
            self.set_view("show the flow after matches", flow_after_match=True)

    @property
    def outdated(self) -> bool:
        """Whether the result belongs to another problem than the document now says."""
        return self._outdated.now(self.document, self.specs, self._evaluated)

    # What is to be shown

    def values(self, side: Side) -> FloatArray | None:
        """The active channel's source or target (V,); None before it was evaluated, or where it cannot be."""
        return self._evaluated.values.get(self.active.spec(side)) if self.active else None

    def error(self, spec: str) -> str:
        """Why a function has no values; empty if it has some or will have."""
        return self._evaluated.errors.get(spec, "")

    @property
    def busy(self) -> str:
        """What it computes in the background besides the solver, and for how long if known; empty if nothing."""
        if self.loading:
            return said("opening", self._loading.step)
        if not self.channels and not self._defaults.error:
            return said("choosing functions", self.step)
        return said("computing functions", self.step) if self.functions.busy else ""

    @property
    def step(self) -> Step | None:
        """What is being done for its functions, if that is told."""
        return self.functions.step if self.channels else self._defaults.step

    # The frame

    def update(self) -> None:
        """Take in what happened since the last frame: call once per frame, before drawing."""
        now = clock.perf_counter()
        elapsed, self._last_update = now - self._last_update, now
        self._finish_loading()
        self._notices.forget(self.history.moves)
        self._find_defaults()
        self._evaluate()
        if not (self.obstacle or self.at_once):  # the functions come first, and pictures off the screen solve nothing
            mesh, parameters = self.mesh, self.parameters  # a match that begins earlier waits for its coarse meshes
            self._coarse_meshes.ask((mesh, parameters.levels), lambda: self.solver.prepare(mesh, parameters))
        if self.dragging or not self.obstacle:  # what cannot be evaluated must not end a run
            self.solver.follow_problem(self.problem, self.dragging)
        if self.view.animate:
            self.player.move_streaks(elapsed)
        if self.player.playing:
            self.amend(time=self.player.advance(self.time, elapsed, self.parameters.tau, self.end))
        self._collect()
        self._keep_what_is_needed()

    def _keep_what_is_needed(self) -> None:
        """Keep of other meshes only what undo, unsaved work and a run that is ending still need."""
        run = self.solver.problem.mesh if self.solver.running and self.solver.problem else None
        now = (self.mesh, run, self.history.moves)
        if not same(now, self._minded):
            self._minded = now
            at_work = {mesh for mesh in (self.mesh, run) if mesh is not None}
            self._kept.forget_all_but(in_history := self.history.meshes)
            self._functions.keep(at_work, at_work | in_history | {left.mesh for left in self.unsaved_documents})

    def _find_defaults(self) -> None:
        if self.channels:
            return
        mesh = self.mesh
        found = self._defaults.ask(mesh, self.functions.evaluator.defaults)
        if found is not None:
            pristine = not self.unsaved
            self.amend(channels=(Channel(*found),))
            if pristine:
                self._kept.keep(self.document, self._kept.origin(self.mesh))
        elif self._defaults.error and self._defaults.key is mesh:
            self.amend(channels=(Channel("coordinate:x", "coordinate:y"),))
            self.say(f"no default functions: {self._defaults.error}", is_error=True)

    def _evaluate(self) -> None:
        if self._evaluated_by is not self.functions:  # values on another mesh
            self._evaluated_by, self._evaluated = self.functions, Evaluated()
        if self.specs:
            self._evaluated = self.functions.ask(self.specs) or self._evaluated
        is_bare = not (self._evaluated.values or self._evaluated.errors)
        self.bare_since = (self.bare_since or clock.perf_counter()) if is_bare else None

    def _collect(self) -> None:
        if (ended := self.solver.collect()) is None:
            return
        match, run, problem = ended
        self._notices.mend(RUN)
        failed, replaced = self.solver.failed, problem.mesh is not self.mesh
        document = self._run_began if replaced else self.document
        self._run_began = self.document
        runs = document.runs if run is None else (*document.runs, run)
        if match is not None:
            self._kept.found(replace(document, result=match, runs=runs))
        if replaced:
            self.solver.forget()
        elif match is not None:
            shows = not (failed or self.at_once or self.dragging)
            view = self.after_match.view(self.view, self.mesh, match) if shows else None
            outcome: dict[str, Any] = {"result": match, "runs": runs, "view": view or self.view}
            self.amend(**outcome) if self._remedied == self.history.moves else self.change("match", **outcome)
            if view is not None:
                self.amend(time=0.0)
                self.player.play_once()
        if failed and not replaced:
            again: WaysOut = {"Try again": self.match}
            if match is not None:  # the newest field that was known
                again = {"Continue": partial(self.match, True), "Match again": partial(self.match, False)}
            self.say(f"the solver stopped: {self.solver.reason}", True, RUN, again)

    def close(self) -> None:
        """End all threads and processes; what is under way is not waited for long."""
        self.solver.close()
        self._functions.close()
        self._jobs.close()

"""A document at work: its functions, its solver, and what they give, taken in once a frame."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import abfm
from abfm import AbfmError, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.computing.evaluation import Evaluated, Functions
from abfm_viewer.computing.solver import Problem, Solver
from abfm_viewer.document.document import Channel, Document, Side
from abfm_viewer.document.history import History
from abfm_viewer.session.after_match import AfterMatch
from abfm_viewer.session.editing import Editing
from abfm_viewer.session.notices import Notice, Notices
from abfm_viewer.session.obstacle import obstacle
from abfm_viewer.session.outdated import Outdated
from abfm_viewer.session.player import Player

if TYPE_CHECKING:
    from abfm.matching import Remedy

_SECONDS_TO_END = 10.0
_SAVED = ("channels", "parameters", "mask", "lines", "points")
"""What besides the result would be lost; the view and the time do not count."""


class Session(Editing):
    """One document, its history, its solver and its player. Knows nothing of the window, nor of pictures.

    If `at_once`, everything is computed when it is asked for, as pictures off the screen need, which wait for no frame.
    While the mouse is `dragging` a widget or a Gaussian, changes are one step of undo.
    """

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool = False) -> None:
        super().__init__(Document(mesh, name))
        self.at_once = at_once
        self.solver = Solver()
        self.player = Player()
        self.after_match = AfterMatch()
        self.dragging = False
        self._notices = Notices()
        # of each mesh, to which undo may come back, what need not be saved, with the project file that it is in
        self._saved: dict[TriangleMesh, tuple[Document, Path | None]] = {mesh: (self.document, None)}
        self._functions: dict[TriangleMesh, Functions] = {}
        self._evaluated = Evaluated()
        self._evaluated_by: Functions | None = None
        self._jobs = Jobs(at_once)
        self._defaults: Latest[tuple[str, str]] = self._jobs.latest("default functions")
        self._loading: Latest[Callable[[], None]] = self._jobs.latest("open")
        self._coarse_meshes: Latest[None] = self._jobs.latest("coarse meshes")
        self._load_count = 0
        self._outdated = Outdated()
        self._remedied = -1  # moves of the history when a remedy began the run: its result belongs to that step
        self._last_update = clock.perf_counter()

    @property
    def path(self) -> Path | None:
        """The project file that Save writes; None before there is one."""
        return self._saved[self.mesh][1] if self.mesh in self._saved else None

    @property
    def unsaved(self) -> bool:
        """Whether something would be lost if the session ended now."""
        if self.mesh not in self._saved:
            return True
        kept, _ = self._saved[self.mesh]
        changed = any(getattr(self.document, name) != getattr(kept, name) for name in _SAVED)
        return changed or self.result is not kept.result

    @property
    def notice(self) -> Notice:
        """What the status line says besides the solver's state."""
        return self._notices.latest

    def say(self, text: str, is_error: bool = False) -> None:
        self._notices.say(text, is_error, self.history.moves)

    def set_time(self, time: float) -> None:
        """Show another time of the time bar; what plays stops."""
        self.player.playing = False
        super().set_time(time)

    def undo(self) -> None:
        """Take back the last step; what plays stops."""
        self.player.playing = False
        self.history.undo()

    def redo(self) -> None:
        """Do again what was taken back; what plays stops."""
        self.player.playing = False
        self.history.redo()

    # Meshes and results

    def set_mesh(self, mesh: TriangleMesh, name: str) -> None:
        """Show another mesh with default functions; the parameters stay."""
        view = replace(self.view, camera=None, front=None)
        fresh = Document(mesh, name, parameters=self.parameters, view=view)
        self.restore(fresh, {}, None, saved=not self.unsaved)
        self.say(" ".join(mesh.messages))

    def load(self, what: str, read: Callable[[], Callable[[], None]]) -> None:
        """Read something in the background; what it returns is called by `update`. Errors go to the status line."""
        self._load_count += 1
        self.say(f"{what} ...")
        self._loading.ask(self._load_count, read)

    def restore(self, document: Document, known: dict[str, FloatArray], path: Path | None, saved: bool = True) -> None:
        """Show an opened document; `known` are values of functions from files (see `Functions`)."""
        self.solver.cancel()
        self.player.playing = False
        self._functions[document.mesh] = Functions(document.mesh, known, self.at_once)
        self.history.change(document, f"open {path.name if path else document.name}")
        if saved:
            self._saved[document.mesh] = document, path

    def mark_saved(self, document: Document, path: Path) -> None:
        """Remember that a document was written to a file."""
        self._saved[document.mesh] = document, path
        self.say(f"saved {path}")

    def reset_history(self) -> None:
        """Forget all steps: the present state is where the user starts."""
        self.history = History(self.document)
        self._saved[self.mesh] = self.document, self.path

    # The solver

    @property
    def functions(self) -> Functions:
        """Values of functions on the mesh."""
        if self.mesh not in self._functions:
            self._functions[self.mesh] = Functions(self.mesh, at_once=self.at_once)
        return self._functions[self.mesh]

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
        if self.obstacle:
            self.say(f"no match yet: {self.obstacle}", is_error=bool(self._evaluated.errors))
            return
        field = None
        warm = self.solver.warm if goes_on is None else goes_on
        if warm and self.result is not None and self.result.mesh is self.mesh:
            field = self.result.start_for(self.parameters)
        self._notices.clear()
        self.player.playing = False
        self.amend(time=self.parameters.tau)
        self._remedied = -1
        self.solver.start(self.problem, self.functions, field)

    def remedy(self, remedy: Remedy) -> None:
        """Do what a verdict proposes: change the parameters, and start a run. With its result it is one step of undo.

        ParameterError if the document's other parameters do not allow it.
        """
        if not (self.solver.running or self.obstacle):
            self.set_parameter(label=remedy.label.lower(), **remedy.parameters)
        self.match(remedy.goes_on)
        self._remedied = self.history.moves if remedy.parameters else -1

    def switch_flow_after_match(self) -> None:
        """Show the flow after the next match, or neither after that nor now."""
        if self.view.flow_after_match:
            self.player.playing = False
            self.set_view("hide the flow after matches", flow_after_match=False, arrows=False, streaks=False)
        else:
            self.after_match.forget()
            self.set_view("show the flow after matches", flow_after_match=True)

    def end_run(self) -> None:
        """End the run, if there is one, and take its best field; the evaluation under way is waited for."""
        self.solver.cancel()
        self.solver.wait(_SECONDS_TO_END)
        self._collect()

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
        """What it computes in the background besides the solver, in a word or two; empty if nothing."""
        if self._loading.busy:
            return "opening"
        if not self.channels and not self._defaults.error:
            return "choosing functions"
        return "computing functions" if self.functions.busy else ""

    # The frame

    def update(self) -> None:
        """Take in what happened since the last frame: call once per frame, before drawing."""
        now = clock.perf_counter()
        elapsed, self._last_update = now - self._last_update, now
        if self._loading.key == self._load_count and self._load_count:
            self._finish_loading()
        self._notices.forget(self.history.moves)
        self._find_defaults()
        self._evaluate()
        if not (self.obstacle or self.at_once):  # the functions come first, and pictures off the screen solve nothing
            mesh, parameters = self.mesh, self.parameters  # a match that begins earlier waits for its coarse meshes
            self._coarse_meshes.ask((mesh, parameters.levels), lambda: abfm.matching.prepare(mesh, parameters))
        if self.dragging or not self.obstacle:  # what cannot be evaluated must not end a run
            self.solver.follow_problem(self.problem, self.dragging)
        if self.view.animate:
            self.player.move_streaks(elapsed)
        if self.player.playing:
            self.amend(time=self.player.advance(self.time, elapsed, self.parameters.tau, self.end))
        self._collect()

    def _finish_loading(self) -> None:
        self._load_count += 1  # this one is done
        if self._loading.error:
            self.say(self._loading.error, is_error=True)
        elif self._loading.value is not None:
            self._notices.clear()
            try:
                self._loading.value()
            except AbfmError as error:
                self.say(str(error), is_error=True)

    def _find_defaults(self) -> None:
        if self.channels:
            return
        mesh = self.mesh
        found = self._defaults.ask(mesh, self.functions.evaluator.defaults)
        if found is not None:
            pristine = not self.unsaved
            self.amend(channels=(Channel(*found),))
            if pristine:
                self._saved[mesh] = self.document, self.path
        elif self._defaults.error and self._defaults.key is mesh:
            self.amend(channels=(Channel("coordinate:x", "coordinate:y"),))
            self.say(f"no default functions: {self._defaults.error}", is_error=True)

    def _evaluate(self) -> None:
        if self._evaluated_by is not self.functions:  # values on another mesh
            self._evaluated_by, self._evaluated = self.functions, Evaluated()
        if self.specs:
            self._evaluated = self.functions.ask(self.specs) or self._evaluated

    def _collect(self) -> None:
        ended = self.solver.collect()
        if ended is None:
            return
        match, run, problem = ended
        if problem.mesh is not self.mesh:  # it was replaced meanwhile
            self.solver.forget()
            return
        runs = self.document.runs if run is None else (*self.document.runs, run)
        if match is not None:
            view = None if self.at_once or self.dragging else self.after_match.view(self.view, self.mesh, match)
            outcome = {"result": match, "runs": runs, "view": view or self.view}
            self.amend(**outcome) if self._remedied == self.history.moves else self.change("match", **outcome)
            if view is not None:
                self.amend(time=0.0)
                self.player.play_once()
        if self.solver.failed:
            self.say(f"the solver stopped: {self.solver.reason}", is_error=True)

    def close(self) -> None:
        """End all threads."""
        self.solver.close()
        for functions in self._functions.values():
            functions.close()
        self._jobs.close()

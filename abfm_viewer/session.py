"""The document and everything that may be done to it: every change goes through here."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from abfm import AbfmError, FunctionError, Parameters, TriangleMesh, load_mesh
from abfm.mesh import FloatArray
from abfm_viewer.background import Latest
from abfm_viewer.document import EXTRAPOLATION, Channel, Document, Point, Run, Side, View
from abfm_viewer.evaluation import Evaluated, Functions
from abfm_viewer.exporter import Exporter
from abfm_viewer.field_quantities import FieldQuantities
from abfm_viewer.history import History
from abfm_viewer.player import Player
from abfm_viewer.solver import Solver
from abfm_viewer.transport import Carried, FlowState
from abfm_viewer.worker import Problem

if TYPE_CHECKING:
    from abfm import Match

_SETTLED = 0.15  # seconds without a new time after which it is worth computing exactly
_SECONDS_OF_NOTICE, _SECONDS_OF_ERROR = 6.0, 12.0


@dataclass(frozen=True)
class Notice:
    """A line for the status bar."""

    text: str
    is_error: bool = False


@dataclass(frozen=True, eq=False)
class _Kept:
    """A document that is in a file, or that is not worth one, as it was opened."""

    document: Document
    path: Path | None


class Session:
    """One document, its history, its solver and its player. Knows nothing of the window.

    Attributes
    ----------
    solver : Solver
    player : Player
    quantities : FieldQuantities
        What can be told of the field and its flow.
    exporter : Exporter
    notice : Notice
        What the status line says besides the solver's state.
    dragging : bool
        Whether the mouse holds a widget or a Gaussian: changes until it lets go are one step of undo.
    """

    def __init__(self, mesh: TriangleMesh, name: str, path: Path | None = None) -> None:
        self.history = History(Document(mesh, name))
        self.solver = Solver()
        self.player = Player()
        self.notice = Notice("")
        self.dragging = False
        self._kept: dict[int, _Kept] = {}
        self._keep(self.document, path)
        self._functions: dict[int, Functions] = {}
        self._evaluated = Evaluated()
        self._evaluated_by: Functions | None = None
        self._defaults: Latest[tuple[str, str]] = Latest("default functions")
        self._loading: Latest[Callable[[], None]] = Latest("open")
        self._load_count = 0
        self.quantities = FieldQuantities()
        self.exporter = Exporter(self.say)
        self._source = Carried("source")
        self._coordinates = Carried("coordinates")
        self._states: dict[int, FlowState] = {}
        self._compared: tuple[list[object], bool] = ([], False)
        self._noticed = (0.0, 0)
        self._last_update = clock.perf_counter()
        self._time_changed = 0.0

    # The document

    @property
    def document(self) -> Document:
        """The present state."""
        return self.history.document

    @property
    def mesh(self) -> TriangleMesh:
        """The document's mesh."""
        return self.document.mesh

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The document's channels; empty while the default functions of a new mesh are being found."""
        return self.document.channels

    @property
    def active(self) -> Channel | None:
        """The active channel."""
        return self.channels[self.document.channel] if self.channels else None

    @property
    def parameters(self) -> Parameters:
        """The document's parameters."""
        return self.document.parameters

    @property
    def view(self) -> View:
        """The document's view."""
        return self.document.view

    @property
    def result(self) -> Match | None:
        """The document's result."""
        return self.document.result

    @property
    def time(self) -> float:
        """The time shown."""
        return self.document.time

    @property
    def end(self) -> float:
        """The end of the time bar."""
        return EXTRAPOLATION * self.parameters.tau

    @property
    def path(self) -> Path | None:
        """The project file that Save writes; None before there is one."""
        kept = self._kept.get(id(self.mesh))
        return kept.path if kept else None

    @property
    def unsaved(self) -> bool:
        """Whether something would be lost if the session ended now; the view and the time do not count."""
        kept = self._kept.get(id(self.mesh))
        if kept is None or self.result is not kept.document.result:
            return True
        names = ("channels", "parameters", "mask", "lines", "points")
        return any(getattr(self.document, name) != getattr(kept.document, name) for name in names)

    def _keep(self, document: Document, path: Path | None) -> None:
        """Remember the state that need not be saved, and where it is, mesh by mesh: undo may come back to another."""
        self._kept[id(document.mesh)] = _Kept(document, path)

    def change(self, label: str, merge: str = "", **values: Any) -> None:
        """Go on to a document with other values, as one step of undo; steps with the same `merge` key are one."""
        document = replace(self.document, **values)
        if any(getattr(document, name) is not getattr(self.document, name) for name in values):
            self.history.change(document, label, merge)

    def amend(self, **values: Any) -> None:
        """Other values without a step of undo: what the user did not do."""
        self.history.amend(replace(self.document, **values))

    def undo(self) -> None:
        """Take back the last step."""
        self.player.playing = False
        self.history.undo()

    def redo(self) -> None:
        """Do again what was taken back."""
        self.player.playing = False
        self.history.redo()

    def say(self, text: str, is_error: bool = False) -> None:
        """Put a line into the status bar."""
        self.notice = Notice(" ".join(text.split()), is_error)
        self._noticed = (clock.perf_counter(), self.history.moves)

    def _forget_notice(self) -> None:
        """Take a notice away when it was there for long enough; an error also when the user did something since."""
        said, moves = self._noticed
        age = clock.perf_counter() - said
        if self.notice.is_error:
            gone = age > _SECONDS_OF_ERROR or self.history.moves != moves
        else:
            gone = age > _SECONDS_OF_NOTICE
        if gone:
            self.notice = Notice("")

    # Meshes and results

    def open_mesh(self, path: str | Path, largest_component: bool = False) -> None:
        """Read a mesh file in the background and show it with default functions."""
        where = Path(path)

        def read() -> Callable[[], None]:
            mesh = load_mesh(where, largest_component=largest_component)
            return partial(self.set_mesh, mesh, where.name)

        self.load(f"opening {where.name}", read)

    def set_mesh(self, mesh: TriangleMesh, name: str) -> None:
        """Show another mesh with default functions; the parameters stay."""
        self.solver.cancel()
        view = replace(self.view, camera=None, front=None)
        self.player.playing = False
        fresh = Document(mesh, name, parameters=self.parameters, view=view)
        pristine = not self.unsaved
        self.history.change(fresh, f"open {name}")
        self.say(" ".join(mesh.messages))
        if pristine:
            self._keep(fresh, None)

    def set_result(
        self,
        match: Match,
        name: str,
        channels: tuple[Channel, ...],
        known: dict[str, FloatArray] | None = None,
        mask: str = "",
    ) -> None:
        """Show a result with the channels and the mask that it was found for; `known` as for `restore`."""
        parameters = match.parameters
        document = Document(
            mesh=match.mesh,
            name=name,
            channels=channels,
            parameters=parameters,
            mask=mask,
            result=match,
            runs=(Run(match.energy_history, match.stages, (), match.mismatch, name),),
            time=parameters.tau,
        )
        self.restore(replace(document, view=replace(self.view, camera=None, front=None)), known or {}, None)

    def load(self, what: str, read: Callable[[], Callable[[], None]]) -> None:
        """Read something in the background; what it returns is called by `update`. Errors go to the status line."""
        self._load_count += 1
        self.say(f"{what} ...")
        self._loading.ask(self._load_count, read)

    def restore(self, document: Document, known: dict[str, FloatArray], path: Path | None, saved: bool = True) -> None:
        """Show an opened project; `known` are values of functions from files (see `Functions`)."""
        self.solver.cancel()
        self.player.playing = False
        self._functions[id(document.mesh)] = Functions(document.mesh, known)
        self.history.change(document, f"open {path.name if path else document.name}")
        if saved:
            self._keep(document, path)

    def mark_saved(self, document: Document, path: Path) -> None:
        """Remember that a document was written to a file."""
        self._keep(document, path)
        self.say(f"saved {path}")

    def reset_history(self) -> None:
        """Forget all steps: the present state is where the user starts."""
        self.history = History(self.document)
        self._keep(self.document, self.path)

    # Channels

    def set_spec(self, side: Side, spec: str, merge: str = "", bump: int | None = None) -> None:
        """Give the active channel another source or target, and make that side active.

        Parameters
        ----------
        bump
            The Gaussian of that side to make active; by default the same as before, or the first of the other side.

        Raises
        ------
        FunctionError
            If the text is no spec; whether it fits the mesh turns out when it is evaluated.
        """
        from abfm.functions import parse

        if self.active is None:
            raise FunctionError("there is no channel yet: wait for the default functions")
        parse(spec)
        changed = replace(self.active, source=spec) if side == "source" else replace(self.active, target=spec)
        if bump is None:
            bump = self.document.bump if side == self.document.side else 0
        if changed == self.active:
            self.select(side=side, bump=bump)
        else:
            self._set_active(changed, f"change the {side}", merge, side=side, bump=bump)

    def set_weight(self, weight: float, merge: str = "") -> None:
        """Give the active channel's mismatch another weight.

        Raises
        ------
        FunctionError
            If it is negative or no number, or all weights would be 0.
        """
        if self.active is None:
            return
        others = [c.weight for i, c in enumerate(self.channels) if i != self.document.channel]
        if not (math.isfinite(weight) and weight >= 0):
            raise FunctionError(f"weight is {weight:g}; expected a number, 0 or more")
        if weight == 0 and not any(others):
            raise FunctionError("weight is 0; at least one channel needs a weight above 0")
        self._set_active(replace(self.active, weight=float(weight)), "change a weight", merge)

    def add_channel(self) -> None:
        """Add a channel of coordinates, which match already, and make it active."""
        self._insert(Channel("coordinate:y", "coordinate:y"), "add a channel")

    def duplicate_channel(self) -> None:
        """Copy the active channel, and make the copy active."""
        if self.active:
            self._insert(self.active, "duplicate a channel")

    def remove_channel(self) -> None:
        """Remove the active channel unless it is the only one."""
        if len(self.channels) > 1:
            kept = [c for i, c in enumerate(self.channels) if i != self.document.channel]
            self.change("remove a channel", channels=tuple(kept), channel=min(self.document.channel, len(kept) - 1))

    def swap_channel(self) -> None:
        """Exchange the active channel's source and target."""
        if self.active:
            swapped = replace(self.active, source=self.active.target, target=self.active.source)
            self._set_active(swapped, "swap source and target")

    def select(self, channel: int | None = None, side: Side | None = None, bump: int | None = None) -> None:
        """Make a channel, side or Gaussian the active one."""
        wanted = {"channel": channel, "side": side, "bump": bump}
        values = {name: value for name, value in wanted.items() if value is not None}
        if side is not None and side != self.document.side and bump is None:
            values["bump"] = 0
        if any(getattr(self.document, name) != value for name, value in values.items()):
            self.change("select", merge="select", **values)

    def _insert(self, channel: Channel, label: str) -> None:
        place = self.document.channel + 1
        channels = (*self.channels[:place], channel, *self.channels[place:])
        self.change(label, channels=channels, channel=min(place, len(channels) - 1), bump=0)

    def _set_active(self, channel: Channel, label: str, merge: str = "", **values: Any) -> None:
        if channel != self.active:
            place = self.document.channel
            channels = (*self.channels[:place], channel, *self.channels[place + 1 :])
            self.change(label, merge, channels=channels, **values)

    # Parameters, mask, view, time

    def set_parameter(self, merge: str = "", label: str = "", **values: Any) -> None:
        """Change parameters by name; `label` is what undo calls it.

        Raises
        ------
        ParameterError
            If a value is refused; nothing has changed then.
        """
        if "method" in values and "segments" not in values:
            values["segments"] = 0
        parameters = Parameters(**(self.parameters.to_dict() | values))
        if parameters != self.parameters:
            time = min(self.time * parameters.tau / self.parameters.tau, EXTRAPOLATION * parameters.tau)
            self.change(label or f"change {', '.join(values)}", merge, parameters=parameters, time=time)

    def set_mask(self, spec: str) -> None:
        """Weight the mismatch at each vertex by a function; empty for no mask.

        Raises
        ------
        FunctionError
            If the text is no spec.
        """
        from abfm.functions import parse

        if spec:
            parse(spec)
        if spec != self.document.mask:
            self.change("change the mask", mask=spec)

    def set_view(self, label: str, merge: str = "", **values: Any) -> None:
        """Change how the document is drawn."""
        view = replace(self.view, **values)
        if view != self.view:
            self.change(label, merge, view=view)

    def set_time(self, time: float) -> None:
        """Show another time of the time bar."""
        time = min(max(time, 0.0), self.end)
        if time != self.time:
            self._time_changed = clock.perf_counter()
            self.change("move in time", merge="time", time=time)

    def add_point(self, kind: Literal["lines", "points"], point: Point) -> None:
        """Start a flow line ("lines") or follow a point ("points")."""
        points = (*getattr(self.document, kind), point)
        self.change("place a point", "", **{kind: points})

    # The solver

    @property
    def functions(self) -> Functions:
        """Values of functions on the mesh."""
        mesh = self.mesh
        if id(mesh) not in self._functions or self._functions[id(mesh)].mesh is not mesh:
            self._functions[id(mesh)] = Functions(mesh)
        return self._functions[id(mesh)]

    @property
    def problem(self) -> Problem:
        """What Match would solve now."""
        return Problem(self.mesh, self.channels, self.parameters, self.document.mask)

    @property
    def obstacle(self) -> str:
        """Why a match cannot start now; empty if it can."""
        if not self.channels:
            return "a source and a target for this mesh are being chosen"
        for spec in self.specs:
            if spec in self._evaluated.errors:
                return f"{spec}: {self._evaluated.errors[spec]}"
        missing = any(spec not in self._evaluated.values for spec in self.specs)
        return "the functions are being computed" if missing else ""

    @property
    def specs(self) -> tuple[str, ...]:
        """Specs of all functions of the document, each once."""
        specs = [spec for channel in self.channels for spec in (channel.source, channel.target)]
        return tuple(dict.fromkeys([*specs, self.document.mask] if self.document.mask else specs))

    def match(self) -> None:
        """Start a run, unless one is under way; if there is nothing to match yet, say why."""
        if self.solver.running:
            return
        if self.obstacle:
            self.say(f"no match yet: {self.obstacle}", is_error=bool(self._evaluated.errors))
            return
        field = self.result.velocity if self.solver.warm and self.result and self.result.mesh is self.mesh else None
        if field is not None and len(field) not in (1, self.parameters.segments):
            self.say(f"the current result has {len(field)} fields: starting from zero")
            field = None
        self.notice = Notice("")
        self.player.playing = False
        self.amend(time=self.parameters.tau)
        self.solver.start(self.problem, self.functions, field)

    @property
    def outdated(self) -> bool:
        """Whether the result belongs to another problem than the document now says."""
        if self.result is None:
            return False
        values = [self._evaluated.values.get(spec) for spec in self.specs]
        seen: list[object] = [self.result, self.parameters, self.channels, self.document.mask, *values]
        before, answer = self._compared
        if len(seen) == len(before) and all(now is then for now, then in zip(seen, before, strict=True)):
            return answer
        known = self.result is before[0] if before else False
        if not known or self._evaluated.errors or all(value is not None for value in values):
            answer = self._differs(self.result)
        self._compared = (seen, answer)
        return answer

    def _differs(self, result: Match) -> bool:
        """Whether a result was found for other parameters or functions, as far as these are known."""
        if result.parameters != self.parameters or len(self.channels) != result.source.shape[1]:
            return True
        if [channel.weight for channel in self.channels] != result.weights.tolist():
            return True
        if (self.document.mask == "") != (result.mask is None):
            return True
        pairs = [(channel.source, result.source[:, i]) for i, channel in enumerate(self.channels)]
        pairs += [(channel.target, result.target[:, i]) for i, channel in enumerate(self.channels)]
        if result.mask is not None:
            pairs.append((self.document.mask, result.mask))
        found = self._evaluated
        return any(
            spec in found.errors or (spec in found.values and not np.array_equal(found.values[spec], then))
            for spec, then in pairs
        )

    # What is to be shown

    def values(self, side: Side) -> FloatArray | None:
        """The active channel's source or target (V,); None before it was evaluated, or where it cannot be."""
        return self._evaluated.values.get(self.active.spec(side)) if self.active else None

    def error(self, spec: str) -> str:
        """Why a function has no values; empty if it has some or will have."""
        return self._evaluated.errors.get(spec, "")

    @property
    def flow(self) -> FlowState | None:
        """The field that is shown: the newest iterate during a run, else the result's."""
        snapshot = self.solver.snapshot
        if snapshot is not None and snapshot.problem.mesh is self.mesh:
            iterate = snapshot.iteration
            return self._state(iterate, iterate.velocity, snapshot.problem.parameters, final=False)
        result = self.result
        return None if result is None else self._state(result, result.velocity, result.parameters, final=True)

    def _state(self, owner: object, velocity: FloatArray, parameters: Parameters, final: bool) -> FlowState:
        if id(owner) not in self._states or self._states[id(owner)].velocity is not velocity:
            self._states = {id(owner): FlowState(self.mesh, velocity, parameters, final)}
        return self._states[id(owner)]

    @property
    def flow_time(self) -> float:
        """The shown time in the time of the flow that is shown (they differ after tau was changed)."""
        flow = self.flow
        return self.time if flow is None else self.time * flow.parameters.tau / self.parameters.tau

    def advected(self) -> FloatArray | None:
        """The active channel's source at the shown time, (V,)."""
        source, flow = self.values("source"), self.flow
        if source is None or flow is None:
            return source
        snapshot, result = self.solver.snapshot, self.result
        at_end = abs(self.flow_time - flow.parameters.tau) <= 1e-9 * flow.parameters.tau
        same_channels = snapshot is not None and len(snapshot.problem.channels) == len(self.channels)
        if at_end and snapshot is not None and not flow.final and same_channels:
            return snapshot.iteration.advected[:, self.document.channel]
        if at_end and flow.final and result is not None and not self.outdated:
            return result.advected[:, self.document.channel]
        carried = self._source.at(flow, source, self.flow_time, self._settled)
        return source if carried is None else carried

    def carried_coordinates(self) -> FloatArray | None:
        """The coordinates (V, 3) carried along to the shown time: where each vertex's value came from."""
        flow = self.flow
        if flow is None:
            return self.mesh.vertices
        return self._coordinates.at(flow, self.mesh.vertices, self.flow_time, self._settled)

    @property
    def _settled(self) -> bool:
        return not self.player.playing and clock.perf_counter() - self._time_changed > _SETTLED

    @property
    def busy(self) -> str:
        """What is computed in the background besides the solver, in a word or two; empty if nothing."""
        if self._loading.busy:
            return "opening"
        if not self.channels and not self._defaults.error:
            return "choosing functions"
        if self.functions.busy:
            return "computing functions"
        return "computing times" if self._source.busy or self._coordinates.busy else ""

    @property
    def flow_note(self) -> str:
        """Why the time bar cannot be followed to its end; empty if it can."""
        return self._source.error

    @property
    def flow_problem(self) -> str:
        """Why the shown time could not be computed exactly; empty if it could."""
        return self._source.problem or self._coordinates.problem

    # The frame

    def update(self) -> None:
        """Take in what happened since the last frame: call once per frame, before drawing."""
        now = clock.perf_counter()
        elapsed, self._last_update = now - self._last_update, now
        if self._loading.key == self._load_count and self._load_count:
            self._finish_loading()
        self._forget_notice()
        self._find_defaults()
        self._evaluate()
        if self.dragging or not self.obstacle:  # what cannot be evaluated must not end a run
            self.solver.follow_problem(self.problem, self.dragging)
        ended = self.solver.collect()
        if ended is not None:
            self._take_result(*ended)
        if self.player.playing:
            self.amend(time=self.player.advance(self.time, elapsed, self.parameters.tau, self.end))

    def _finish_loading(self) -> None:
        self._load_count += 1  # this one is done
        if self._loading.error:
            self.say(self._loading.error, is_error=True)
        elif self._loading.value is not None:
            self.notice = Notice("")
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
                self._keep(self.document, self.path)
        elif self._defaults.error and self._defaults.key is mesh:
            self.amend(channels=(Channel("coordinate:x", "coordinate:y"),))
            self.say(f"no default functions: {self._defaults.error}", is_error=True)

    def _evaluate(self) -> None:
        if self._evaluated_by is not self.functions:  # values on another mesh
            self._evaluated_by, self._evaluated = self.functions, Evaluated()
        if self.specs:
            evaluated = self.functions.ask(self.specs)
            if evaluated is not None:
                self._evaluated = evaluated

    def _take_result(self, match: Match | None, run: Run | None, problem: Problem) -> None:
        if problem.mesh is not self.mesh:  # it was replaced meanwhile
            self.solver.forget()
            return
        runs = self.document.runs if run is None else (*self.document.runs, run)
        if match is not None:
            self.change("match", result=match, runs=runs)
        if self.solver.failed:
            self.say(f"the solver stopped: {self.solver.reason}", is_error=True)

    def close(self) -> None:
        """End all threads."""
        self.exporter.close()
        self.quantities.close()
        self.solver.close()
        for functions in self._functions.values():
            functions.close()
        for service in (self._defaults, self._loading, self._source, self._coordinates):
            service.close()

"""What the user may change in a document: every change goes through here and is a step of undo."""

from __future__ import annotations

import math
import time as clock
from dataclasses import replace
from typing import Any, Literal

import abfm
from abfm import FunctionError, Parameters
from abfm_viewer.document.document import EXTRAPOLATION, SIDES, Channel, Document, Point, Side
from abfm_viewer.document.gaussians import landmark
from abfm_viewer.document.history import History


class Editor:
    """Commands on a document and its history.

    `time_changed` is when the user last moved in time, by `time.perf_counter`.
    """

    def __init__(self, document: Document) -> None:
        self.history = History(document)
        self.time_changed = 0.0

    @property
    def document(self) -> Document:
        return self.history.document

    def change(self, label: str, merge: str = "", **values: Any) -> None:
        """Go on to other values as one step of undo; steps with the same `merge` key are one."""
        before = self.document
        if any(getattr(before, name) is not value for name, value in values.items()):
            self.history.change(replace(before, **values), label, merge)

    def amend(self, **values: Any) -> None:
        """Go on to other values without a step of undo: what the user did not do."""
        self.history.document = replace(self.document, **values)

    def set_spec(self, side: Side, spec: str, merge: str = "", bump: int | None = None) -> None:
        """Give the active channel another source or target, and make that side active.

        So does its Gaussian `bump`, by default the same as before, or the first of the other side.
        FunctionError if the text is no spec; whether it fits the mesh turns out in evaluation.
        """
        document = self.document
        if document.active is None:
            raise FunctionError("there is no channel yet: wait for the default functions")
        abfm.functions.parse(spec)
        changed = document.active.changed(side, spec)
        if bump is None:
            bump = document.bump if side == document.side else 0
        if changed == document.active:
            self.select(side=side, bump=bump)
        else:
            self._put(f"change the {side}", changed, merge=merge, side=side, bump=bump)

    def set_weight(self, weight: float, merge: str = "") -> None:
        """Set the active channel's weight; FunctionError unless at least one is above 0."""
        if (active := self.document.active) is None:
            return
        if not (math.isfinite(weight) and weight >= 0):
            raise FunctionError(f"weight is {weight:g}; expected a number, 0 or more")
        if weight == 0 and not any(channel.weight for channel in self._others):
            raise FunctionError("weight is 0; at least one channel needs a weight above 0")
        if weight != active.weight:
            self._put("change a weight", replace(active, weight=float(weight)), merge=merge)

    def add_channel(self) -> None:
        """Add a channel and make it active: a landmark that stays, far from others' Gaussians."""
        document = self.document
        specs = [channel.spec(side) for channel in document.channels for side in SIDES]
        stays = landmark(specs, document.surface().mesh)
        self._insert("add a channel", Channel(stays, stays))

    def duplicate_channel(self) -> None:
        if self.document.active:
            self._insert("duplicate a channel", self.document.active)

    def remove_channel(self) -> None:
        """Remove the active channel unless it is the only one; some other has a weight then."""
        if others := self._others:
            if not any(channel.weight for channel in others):
                others = [replace(channel, weight=1.0) for channel in others]
            place = min(self.document.channel, len(others) - 1)
            self.change("remove a channel", channels=tuple(others), channel=place)

    def swap_channel(self) -> None:
        if (active := self.document.active) and active.source != active.target:
            swapped = replace(active, source=active.target, target=active.source)
            self._put("swap source and target", swapped)

    def select(
        self, channel: int | None = None, side: Side | None = None, bump: int | None = None
    ) -> None:
        wanted = {"channel": channel, "side": side, "bump": bump}
        values = {name: value for name, value in wanted.items() if value is not None}
        if side is not None and side != self.document.side and bump is None:
            values["bump"] = 0
        if any(getattr(self.document, name) != value for name, value in values.items()):
            self.change("select", merge="select", **values)

    @property
    def _others(self) -> list[Channel]:
        channels, place = self.document.channels, self.document.channel
        return [*channels[:place], *channels[place + 1 :]]

    def _insert(self, label: str, channel: Channel) -> None:
        before = [self.document.active] if self.document.active else []
        self._put(label, *before, channel, channel=self.document.channel + len(before), bump=0)

    def _put(self, label: str, *by: Channel, merge: str = "", **values: Any) -> None:
        channels, place = self.document.channels, self.document.channel
        channels = (*channels[:place], *by, *channels[place + 1 :])
        self.change(label, merge, channels=channels, **values)

    def set_parameter(self, merge: str = "", label: str = "", **values: Any) -> None:
        """Change parameters by name, or none (ParameterError) if a value is refused."""
        before = self.document.parameters
        if "method" in values and "segments" not in values:
            values["segments"] = 0
        parameters = Parameters(**(before.to_dict() | values))
        if parameters != before:
            label = label or f"change {', '.join(values)}"
            time = self.document.time * parameters.tau / before.tau
            time = min(time, EXTRAPOLATION * parameters.tau)
            self.change(label, merge, parameters=parameters, time=time)

    def reset_parameters(self) -> None:
        self.set_parameter(label="reset the parameters", **Parameters().to_dict())

    def set_mask(self, spec: str) -> None:
        """Weight the mismatch at each vertex by a function, or none; FunctionError if no spec."""
        if spec:
            abfm.functions.parse(spec)
        if spec != self.document.mask:
            self.change("change the mask", mask=spec)

    def set_view(self, label: str, merge: str = "", **values: Any) -> None:
        view = replace(self.document.view, **values)
        if view != self.document.view:
            self.change(label, merge, view=view)

    def set_time(self, time: float) -> None:
        time = min(max(time, 0.0), self.document.end)
        if time != self.document.time:
            self.time_changed = clock.perf_counter()
            self.change("move in time", merge="time", time=time)

    def add_point(self, kind: Literal["lines", "points"], point: Point) -> None:
        self.change("place a point", "", **{kind: (*getattr(self.document, kind), point)})

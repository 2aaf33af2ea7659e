"""Editing of documents with undo and redo."""

import math
import time as clock
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import abfm
from abfm import FunctionError, Parameters
from abfm_viewer.document.document import EXTRAPOLATION, Channel, Document, Landmark, Point, Side
from abfm_viewer.document.kinds import MatchDocument, SequenceDocument

UNDO_STEPS_MAX = 200
UNDO_BYTES_MAX = 500_000_000
"""Limits of the history: number of steps, and bytes of meshes and results.

The latest step is always kept and does not count."""


class Step(NamedTuple):
    """Entry of the undo or redo history: a document before a change, with a label of the change."""

    document: Document
    label: str  # description of the change
    merge: str  # key: next changes with the same key belong to this step
    changes_viewpoint: bool  # whether the change affects the viewpoint or enlarges a slot


class Editor:
    """Commands that change a document, with undo and redo.

    Each change of the document is a step of undo. Consecutive changes with the same key ``merge``,
    such as those of a drag, are one step. Undo restores the viewpoint only for steps that changed
    it.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        self.time_changed = 0.0  # last change of the shown time, by `time.perf_counter`
        self.forget_steps()

    def forget_steps(self) -> None:
        self.action_count = 0  # number of changes, undos and redos
        self.past: list[Step] = []  # for undo
        self.future: list[Step] = []  # for redo

    @property
    def draft(self) -> MatchDocument:
        assert isinstance(self.document, MatchDocument)
        return self.document

    @property
    def documents(self) -> list[Document]:
        return [self.document, *(step.document for step in (*self.past, *self.future))]

    @property
    def undo_label(self) -> str:
        return self.past[-1].label if self.past else ""

    @property
    def redo_label(self) -> str:
        return self.future[-1].label if self.future else ""

    def go_to(self, document: Document, label: str, merge: str = "") -> None:
        """Replace the document, as a step of undo that ``label`` describes."""
        if not (merge and self.past and self.past[-1].merge == merge):
            changes_viewpoint = _viewpoint_differs(self.document, document)
            self.past.append(Step(self.document, label, merge, changes_viewpoint))
            del self.past[: -self._step_limit()]
        self.future.clear()
        self.document = document
        self.action_count += 1

    def seal(self) -> None:
        """Make the next change a separate step of undo, even if its key ``merge`` is the same."""
        if self.past:
            self.past[-1] = self.past[-1]._replace(merge="")

    def join_steps(self) -> None:
        """Make one step of undo from the last two."""
        *self.past, first, last = self.past
        self.past.append(first._replace(label=last.label))

    def undo(self) -> None:
        self._move(self.past, self.future)

    def redo(self) -> None:
        self._move(self.future, self.past)

    def _step_limit(self) -> int:
        """Return how many of the latest steps to keep within the limits, at least one."""
        counted, remaining_bytes = set(_large_parts(self.document)), UNDO_BYTES_MAX
        for count, step in enumerate(reversed(self.past)):
            parts = _large_parts(step.document)
            remaining_bytes -= sum(parts[key] for key in parts.keys() - counted)
            counted |= parts.keys()
            if count == UNDO_STEPS_MAX or (count and remaining_bytes < 0):
                return count
        return len(self.past)

    def _move(self, source: list[Step], destination: list[Step]) -> None:
        if source:
            step, now = source.pop(), self.document
            destination.append(step._replace(document=now, merge=""))
            self.document = step.document
            if not step.changes_viewpoint and _viewpoint_differs(now, step.document):
                seen = replace(
                    step.document.view, viewpoint=now.view.viewpoint, enlarged=now.view.enlarged
                )
                self.document = replace(step.document, view=seen)
            seen = self.document.view.with_appearance(**now.view.appearance)
            if seen is not self.document.view:
                self.document = replace(self.document, view=seen)
            self.action_count += 1

    def change(self, label: str, merge: str = "", **values: Any) -> None:
        """Set fields of the document as a step of undo; do nothing if all values are the same."""
        before = self.document
        if any(getattr(before, name) != value for name, value in values.items()):
            self.go_to(replace(before, **values), label, merge)

    def amend(self, **values: Any) -> None:
        """Set fields of the document without a step of undo, as for changes by a computation."""
        self.document = replace(self.document, **values)

    def set_spec(self, side: Side, spec: str, merge: str = "", bump: int | None = None) -> None:
        """Change the spec of the active channel's source or target, and make that side active.

        An invalid spec raises a `FunctionError`; whether it fits the mesh is checked when it is
        evaluated. Gaussian number ``bump`` becomes active, by default the same as before, or the
        first one of another side.
        """
        document = self.draft
        if document.active is None:
            raise FunctionError("there is no channel yet; wait for the default functions")
        abfm.functions.parse(spec)
        changed = document.active.changed(side, spec)
        if bump is None:
            bump = document.bump if side == document.side else 0
        if changed == document.active:
            self.select(side=side, bump=bump)
        else:
            self._put(f"change the {side}", changed, merge=merge, side=side, bump=bump)

    def set_weight(self, weight: float, merge: str = "") -> None:
        """Set the weight of the active channel; a `FunctionError` states why it is refused."""
        if (active := self.document.active) is None:
            return
        if not (math.isfinite(weight) and weight >= 0):
            raise FunctionError(f"weight is {weight:g}; expected a number, 0 or more")
        if weight == 0 and not any(channel.weight for channel in self._others):
            raise FunctionError("weight is 0; at least one channel needs a weight above 0")
        self._put("change a weight", replace(active, weight=float(weight)), merge=merge)

    def add_channel(self) -> None:
        """Add a channel of a fixed Gaussian, far from all others, and make it active."""
        self._insert("add a channel", self.draft.new_channel())

    def duplicate_channel(self) -> None:
        if self.document.active:
            self._insert("duplicate a channel", self.document.active)

    def remove_channel(self) -> None:
        """Remove the active channel unless it is the only one; weights that are all 0 become 1."""
        if others := self._others:
            if not any(channel.weight for channel in others):
                others = [replace(channel, weight=1.0) for channel in others]
            place = min(self.document.channel, len(others) - 1)
            self.change("remove a channel", channels=tuple(others), channel=place)

    def set_circular(self, period: float | None) -> None:
        """Compare the active channel by cosine and sine of a period; None compares its values."""
        document = self.document
        if (active := document.active) is None:
            return
        plain = [abfm.functions.without_circle(spec) for spec in active.specs]
        source, target = plain
        split = abfm.functions.split_channels([source], [target], [active.weight], period)
        made = [Channel(*each) for each in zip(*split, strict=True)]
        channels, place = list[Channel](), 0
        for channel in document.channels:
            if [abfm.functions.without_circle(spec) for spec in channel.specs] != plain:
                channels.append(channel)
            elif made:
                place = len(channels)
                channels, made = channels + made, []
        self.change("change circular", channels=tuple(channels), channel=place)

    def swap_channel(self) -> None:
        if active := self.document.active:
            swapped = replace(active, source=active.target, target=active.source)
            self._put("swap source and target", swapped)

    def select(self, **values: Any) -> None:
        """Make a channel, a landmark, or a side with its Gaussian (number `bump`) active."""
        self.change("select", merge="select", **values)

    @property
    def _others(self) -> list[Channel]:
        channels, place = self.document.channels, self.document.channel
        return [*channels[:place], *channels[place + 1 :]]

    def _insert(self, label: str, channel: Channel) -> None:
        before = [self.document.active] if self.document.active else []
        self._put(label, *before, channel, channel=self.document.channel + len(before), bump=0)

    def _put(self, label: str, *replacement: Channel, merge: str = "", **values: Any) -> None:
        channels, place = self.document.channels, self.document.channel
        channels = (*channels[:place], *replacement, *channels[place + 1 :])
        self.change(label, merge, channels=channels, **values)

    def set_parameter(self, merge: str = "", label: str = "", **values: Any) -> None:
        """Change parameters of the match by name; an invalid value raises a `ParameterError`.

        If tau changes, the shown time changes in proportion.
        """
        before = self.document.parameters
        if "method" in values and "segments" not in values:
            values["segments"] = 0
        parameters = before.with_values(**values)
        if parameters != before:
            label = label or f"change {', '.join(values)}"
            time = self.document.time * parameters.tau / before.tau
            time = min(time, EXTRAPOLATION * parameters.tau)
            self.change(label, merge, parameters=parameters, time=time)

    def reset_parameters(self) -> None:
        self.set_parameter(label="reset the parameters", **Parameters().to_dict())

    def set_sequence_settings(self, merge: str = "", label: str = "", **values: Any) -> None:
        """Change settings of a sequence by name; an invalid value raises a `ParameterError`."""
        assert isinstance(self.document, SequenceDocument)
        settings = replace(self.document.settings, **values)
        settings.check()
        self.change(label or f"change {', '.join(values)}", merge, settings=settings)

    def set_mask(self, spec: str) -> None:
        """Set the spec (text) of the mask, empty for none; if invalid, raise a `FunctionError`."""
        if spec:
            abfm.functions.parse(spec)
        self.change("change the mask", mask=spec)

    def set_view(self, label: str, merge: str = "", **values: Any) -> None:
        self.change(label, merge, view=replace(self.document.view, **values))

    def set_time(self, time: float) -> None:
        time = min(max(time, self.document.start), self.document.end)
        if time != self.document.time:
            self.time_changed = clock.perf_counter()
            self.change("move in time", merge="time", time=time)

    def switch_placing(self) -> None:
        tool = "nothing" if self.document.view.tool == "landmark" else "landmark"
        self.set_view("choose what a click does", tool=tool)

    def place_landmark(self, side: Side, point: Point) -> None:
        """Place a point of the first landmark without one on this side, or of a new landmark."""
        landmarks = [*self.document.landmarks]
        incomplete = (n for n, one in enumerate(landmarks) if one.point(side) is None)
        number = next(incomplete, len(landmarks))
        if number == len(landmarks):
            landmarks.append(Landmark())
        landmarks[number] = landmarks[number].placed(side, point)
        self.set_landmarks("place a landmark", tuple(landmarks), number)

    def move_landmark(self, number: int, side: Side, point: Point, merge: str) -> None:
        landmarks = [*self.document.landmarks]
        landmarks[number] = landmarks[number].placed(side, point)
        self.set_landmarks("move a landmark", tuple(landmarks), number, merge)

    def remove_landmark(self) -> None:
        landmarks, number = self.document.landmarks, self.draft.landmark
        others = (*landmarks[:number], *landmarks[number + 1 :])
        self.set_landmarks("remove a landmark", others, max(min(number, len(others) - 1), 0))

    def set_landmarks(
        self, label: str, landmarks: tuple[Landmark, ...], active: int = 0, merge: str = ""
    ) -> None:
        if landmarks != self.document.landmarks:
            self.change(label, merge, landmarks=landmarks, landmark=active)


def _large_parts(document: Document) -> dict[int, int]:
    """Return the bytes of each array of a document's meshes and results, by `id` of the array."""
    arrays = [array for part in document.large_parts for array in vars(part).values()]
    return {id(array): array.nbytes for array in arrays if isinstance(array, np.ndarray)}


def _viewpoint_differs(before: Document, after: Document) -> bool:
    """Return whether two states differ in viewpoint, enlarged picture or document."""
    one, other = before.view, after.view
    is_other = before.identity is not after.identity
    return is_other or one.viewpoint is not other.viewpoint or one.enlarged != other.enlarged

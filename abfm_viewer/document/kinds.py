"""Kinds of documents: match, pair of surfaces, subject of a population, sequence of frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from abfm import Parameters
from abfm.display import BEST_VIEW, ViewSpec
from abfm.pages.front import Front, same_side
from abfm.types import BoolArray, FloatArray
from abfm_viewer.document import gaussians
from abfm_viewer.document.comparison import Comparison
from abfm_viewer.document.document import (
    DEFAULT_PARAMETERS,
    SIDES,
    Channel,
    Document,
    Function,
    InitialMap,
    Landmark,
    MapRequest,
    MissingValues,
    RangeValues,
    RunRecord,
    Side,
    Surface,
    Values,
    View,
)
from abfm_viewer.document.frame_sequence import (
    FRAMES_A_SECOND,
    FrameSequence,
    SequenceSettings,
    settings_of,
)
from abfm_viewer.document.keyboard import hint
from abfm_viewer.document.surface_points import landmarks_of_match

if TYPE_CHECKING:  # documents without a result do not load the types of results
    from abfm import Match, Registration, Sequence

MEASURED_COLUMN = "measured"
"""Column of a mask that is 0 where functions had no values and were filled in."""
OF_A = "A: "  # prefix of the keys of values on surface A of two, see `values_key`
GIVEN_WORD = "given"  # value of `initial` for the map in a registration file


@dataclass(frozen=True, eq=False)
class MatchDocument(Document):
    """Pairs of functions to match on one surface, source and target, and the parameters."""

    content_fields: ClassVar[tuple[str, ...]] = (
        *("channels", "parameters", "mask", "landmarks", "landmarks_alone"),
        *Document.content_fields,
    )

    channels: tuple[Channel, ...] = ()  # empty until a new mesh has its default functions
    parameters: Parameters = DEFAULT_PARAMETERS
    mask: str = ""
    side: Side = field(default="source", kw_only=True)  # active side of the active channel
    bump: int = field(default=0, kw_only=True)  # active Gaussian of that side
    landmarks: tuple[Landmark, ...] = field(default=(), kw_only=True)
    landmark: int = field(default=0, kw_only=True)  # active landmark
    # whether landmarks, if there are any, are matched without the functions
    landmarks_alone: bool = field(default=False, kw_only=True)
    result: Match | None = field(default=None, kw_only=True)
    # number of the step that the solver chose; None if this step is shown
    solver_step: int | None = field(default=None, kw_only=True)
    runs: tuple[RunRecord, ...] = field(default=(), kw_only=True)  # ended runs, the latest last
    # names under which functions of results are shown, by their specs
    display_names: dict[str, str] = field(default_factory=dict, kw_only=True)

    @property
    def match(self) -> Match | None:
        return self.result

    @property
    def is_of_landmarks(self) -> bool:
        return self.landmarks_alone and bool(self.pairs)

    @property
    def initial(self) -> str:
        """Method for the initial map from surface A to B; empty for an automatic choice."""
        return ""

    @property
    def map_request(self) -> MapRequest:
        return MapRequest(self.initial, self.channels, self.mask, self.pairs, self.landmarks_alone)

    @property
    def weights(self) -> tuple[float, ...]:
        """Weight of each channel's mismatch; 0 if landmarks alone are matched."""
        return tuple(0.0 if self.is_of_landmarks else one.weight for one in self.channels)

    def function(self, side: Side, channel: Channel | None = None) -> Function:
        channel = channel or self.channels[self.channel]
        return Function(self.surface(side), channel.spec(side))

    @property
    def mask_function(self) -> Function:
        return Function(self.surface("target"), self.mask)

    @cached_property
    def functions(self) -> tuple[Function, ...]:
        found = [self.function(side, channel) for channel in self.channels for side in SIDES]
        return tuple(dict.fromkeys([*found, self.mask_function] if self.mask else found))

    def new_channel(self) -> Channel:
        """Return a channel of a Gaussian that stays fixed, far from those of the other channels."""
        specs = [channel.spec(side) for channel in self.channels for side in SIDES]
        fixed = gaussians.landmark(specs, self.surface().mesh)
        return Channel(fixed, fixed)

    def renamed(self, name: str, display_names: Mapping[str, str]) -> Self:
        runs = tuple(replace(run, label=name) for run in self.runs)
        renamed = super().renamed(name, display_names)
        return replace(renamed, runs=runs, display_names=dict(display_names))

    def missing_values(self, slot: str, values: Values) -> MissingValues:
        """Return a cache key, and a function that finds where the active functions lack values.

        In a match of two frames, vertices where the mask of the frames is 0 also lack values.
        """
        active = [] if self.active is None else [self.function(side) for side in SIDES]
        given = [found for one in active if (found := values(one)) is not None]
        is_of_frames = self.mask.endswith(f",column={MEASURED_COLUMN}")
        mask = values(self.mask_function) if active and is_of_frames else None

        def find() -> BoolArray | None:
            missing = [np.isnan(found) for found in given]
            missing += [] if mask is None else [np.asarray(mask == 0)]
            found = np.any(missing, axis=0)
            return found if found.any() else None

        return (mask, *given), find

    def outcome(
        self, match: Match | None, run: RunRecord | None, initial: InitialMap | None
    ) -> dict[str, Any]:
        """Return new values, by field, for a document whose run has ended.

        ``initial`` is the initial map with which the run started; None for one surface.
        """
        runs = self.runs if run is None else (*self.runs, run)
        return {"result": match, "runs": runs, "solver_step": None}

    def check(self) -> None:
        steps = len(self.result.path) if self.result else 0
        for name, count in (("solver_step", steps), ("landmark", max(len(self.landmarks), 1))):
            value = getattr(self, name)
            if value is not None and not 0 <= value < count:
                raise ValueError(f"{name} is {value}; expected 0 to {count - 1}")
        if self.bump < 0:
            raise ValueError(f"bump, the number of a Gaussian, is {self.bump}; expected 0 or more")

    def differs(self, result: Match, values: Values) -> bool:
        alone = self.landmarks_alone and result.problem.is_of_landmarks
        return (
            len(self.channels) != result.source.shape[1]
            or result.parameters != self.parameters
            or not (alone or [*self.weights] == result.weights.tolist())
            or self.has_other_functions(result, values)
        )

    def has_other_functions(self, result: Match, values: Values) -> bool:
        """Return whether functions (where unmasked), mask or landmarks differ from a result's."""
        nameless = tuple(replace(pair, name="") for pair in self.pairs)
        if nameless != landmarks_of_match(result):
            return True
        functions = [self.function(side, channel) for side in SIDES for channel in self.channels]
        found = [known for one in functions if (known := values(one)) is not None]
        mask = values(self.mask_function) if self.mask else np.ones(len(result.source))
        if mask is None or len(found) < len(functions):
            return True
        now, then = np.array(found), np.concatenate([result.source.T, result.target.T])
        has_value = ~np.isnan(now).any(axis=0)
        mask = mask * has_value
        is_compared = mask > 0  # other values have no effect
        return not (
            (self.mask == "" and has_value.all()) == (result.mask is None)
            and np.array_equal(mask, np.ones(len(mask)) if result.mask is None else result.mask)
            and np.array_equal(now[:, is_compared], then[:, is_compared])
        )

    def unsaved_text(self, changes: Collection[str], has_new_result: bool) -> str:
        if self.result is None or not has_new_result:
            return super().unsaved_text(changes, has_new_result)
        return f"The match of {self.name} ({self.result.facts.headline}) is not saved."

    @property
    def large_parts(self) -> tuple[object, ...]:
        found = () if self.result is None else (self.result, *self.result.path)
        return (*super().large_parts, *found)  # arrays that steps share count once


@dataclass(frozen=True, eq=False)
class PairDocument(MatchDocument):
    """Surfaces A and B to be registered, and the functions that are matched for this.

    An initial map transfers the functions of A to B, where they are matched.
    """

    content_fields: ClassVar[tuple[str, ...]] = ("initial", *MatchDocument.content_fields)
    surface_count: ClassVar[int] = 2

    initial: str = field(default="", kw_only=True)
    initial_map: InitialMap | None = field(default=None, kw_only=True)

    @property
    def name(self) -> str:
        return " to ".join(surface.name for surface in self.surfaces)

    @property
    def complete_result(self) -> Match | Registration | None:
        match, initial = self.result, self.initial_map
        return match if match is None or initial is None else initial.registration(match)

    def slot_title(self, slot: str) -> str:
        return f"{slot} on {'A' if slot == 'source' else 'B'}"

    def transferred_title(self, kind: str) -> str:
        return f"{kind} of A, on B"

    def surface_label(self, side: Side) -> str:
        return {"source": "A", "target": "B"}[side]

    def facing(self, view: ViewSpec, *functions: FloatArray) -> Self:
        return super().facing(view, *functions).with_corresponding_front(self.initial_map, view)

    def with_corresponding_front(
        self, initial: InitialMap | None, view: ViewSpec = BEST_VIEW
    ) -> Self:
        """Return the document with A shown from the side of B, by a map or else by the axes."""
        a, b = self.surfaces
        if b.front is None:
            return self
        if initial is not None:
            # imported late: loads many modules
            from abfm.pages.registration_views import corresponding_front

            front = corresponding_front(initial.correspondence, b.front, view)
        else:
            front = same_side(b.front, b.mesh, a.mesh, view.up)
        return replace(self, surfaces=(replace(a, front=front), b))

    def renamed(self, name: str, display_names: Mapping[str, str]) -> Self:
        found = super().renamed(name, display_names)
        a, b = found.surfaces
        return replace(found, surfaces=(a, replace(b, name=f"B of {name}")))

    def values_key(self, side: Side, spec: str) -> str:
        return f"{OF_A}{spec}" if side == "source" else spec

    def values_on(self, side: Side, known: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        names = [name for name in known if name.startswith(OF_A) == (side == "source")]
        return {name.removeprefix(OF_A): known[name] for name in names}

    def new_channel(self) -> Channel:
        source, target = (
            gaussians.landmark([one.spec(side) for one in self.channels], self.surface(side).mesh)
            for side in SIDES
        )
        return Channel(source, target)

    def missing_values(self, slot: str, values: Values) -> MissingValues:
        return Document.missing_values(self, slot, values)

    def outcome(
        self, match: Match | None, run: RunRecord | None, initial: InitialMap | None
    ) -> dict[str, Any]:
        return super().outcome(match, run, initial) | {"initial_map": initial}

    def has_other_functions(self, result: Match, values: Values) -> bool:
        return self.initial_map is None or not self.initial_map.is_for(self)

    @property
    def large_parts(self) -> tuple[object, ...]:
        initial = self.initial_map
        found = () if initial is None else (initial.correspondence.points,)
        return (*super().large_parts, *found)


@dataclass(frozen=True, eq=False)
class SubjectDocument(MatchDocument):
    """A subject of a population on the template, compared with the mean of the other subjects."""

    comparison: Comparison = field(kw_only=True)

    def saved(self) -> MatchDocument:
        """Return the document without the population, which has its own file."""
        return MatchDocument(**{one.name: getattr(self, one.name) for one in fields(MatchDocument)})

    @property
    def active_comparison(self) -> Comparison | None:
        active, found = self.active, self.comparison
        if active is None:
            return None
        return found if (active.source, active.target) in found.channels else None

    def slot_title(self, slot: str) -> str:
        if self.active_comparison is None or (slot == "advected" and self.result):
            return slot
        return self.active_comparison.title(slot)

    def missing_values(self, slot: str, values: Values) -> MissingValues:
        comparison, active = self.active_comparison, self.active
        if comparison is None or active is None:
            return super().missing_values(slot, values)
        channel = comparison.channels[active.source, active.target]
        return (comparison, channel), lambda: comparison.unknown(slot, channel)


_SEQUENCE_PARTS = {
    "sequence": "times of its frames",
    "settings": "changed parameters",
    "lines": "flow lines",
    "points": "followed points",
}
"""Names of parts of a sequence that a file of its fields does not contain."""


@dataclass(frozen=True, eq=False)
class SequenceDocument(Document):
    """A sequence of frames, and the settings with which all its intervals are matched."""

    match_label: ClassVar[str] = "Match all frames"
    match_tip: ClassVar[str] = "Find the fields that advect each frame to the next, all in one run."
    cancel_tip: ClassVar[str] = (
        f"End the run and keep the fields found so far ({hint('cancel')}). The next run resumes "
        "from them."
    )
    play_tips: ClassVar[tuple[str, ...]] = (
        "Play the frames.",
        "Show the previous frame.",
        "Show the next frame.",
        "Show the first frame.",
    )
    speed_tip: ClassVar[str] = f"Playing speed: 1 is {FRAMES_A_SECOND:g} frames per second."
    extrapolates: ClassVar[bool] = False
    has_one_field: ClassVar[bool] = False
    has_sides: ClassVar[bool] = False
    content_fields: ClassVar[tuple[str, ...]] = ("sequence", "settings", *Document.content_fields)
    exported_fields: ClassVar[tuple[str, ...]] = ("sequence", "settings", "result")

    sequence: FrameSequence
    settings: SequenceSettings = field(default=SequenceSettings(), kw_only=True)
    result: Sequence | None = field(default=None, kw_only=True)

    @property
    def name(self) -> str:
        surface = self.surface().name
        return surface if self.sequence.name == surface else f"{self.sequence.name} on {surface}"

    def slot_title(self, slot: str) -> str:
        before = self.interval
        titles = {
            "source": self.sequence.frame_label(before),
            "advected": f"at {self.sequence.precise_time(self.time)}",
            "target": self.sequence.frame_label(before + 1),
        }
        return titles.get(slot, slot)

    @property
    def channel_count(self) -> int:
        return self.sequence.channels

    def renamed(self, name: str, display_names: Mapping[str, str]) -> Self:
        sequence = replace(self.sequence, name=name)
        return replace(super().renamed(name, display_names), sequence=sequence)

    def front(self, view: ViewSpec, *functions: FloatArray) -> Front:
        return self.sequence.front(view)

    def missing_values(self, slot: str, values: Values) -> MissingValues:
        return (self.sequence,), lambda: self.sequence.frames.unknown

    def color_range_values(self, source: FloatArray, target: FloatArray) -> RangeValues:
        channel = self.channel  # one colour range for all frames
        return (self.sequence, channel), lambda: (self.sequence.frames.values[:, :, channel],)

    @property
    def start(self) -> float:
        return float(self.sequence.times[0])

    @property
    def end(self) -> float:
        return float(self.sequence.times[-1])

    @property
    def last_target_time(self) -> float:
        return self.end

    @property
    def flow_time(self) -> float:
        return self.time - float(self.sequence.times[self.interval])

    @property
    def tau(self) -> float:
        return float(self.sequence.frames.durations[self.interval])

    @property
    def interval(self) -> int:
        return self.sequence.interval(self.time)

    @property
    def ticks(self) -> tuple[float, ...]:
        return tuple(self.sequence.times.tolist())

    def time_after(self, share: float) -> float:
        return self.sequence.next_frame(self.time, 1 if share > 0 else -1)

    @property
    def time_range_label(self) -> str:
        return f"{self.sequence.time_text(self.start)} to {self.sequence.time_text(self.end)}"

    @property
    def slider_tip(self) -> str:
        return f"{self.slot_title('source')}; {self.slot_title('target')} is next."

    @property
    def sequence_result(self) -> Sequence | None:
        return self.result

    @property
    def is_outdated(self) -> bool:
        found = self.result
        return found is not None and not (
            found.frames is self.sequence.frames.values and settings_of(found) == self.settings
        )

    def check(self) -> None:
        self.settings.check()
        for frames in (self.sequence.frames, self.sequence.phases or self.sequence.frames):
            if len(frames.times) < 2 or not (frames.durations > 0).all():
                raise ValueError("the times of the frames are not in ascending order")
            if frames.mesh is not self.surface().mesh:
                raise ValueError("the frames are on another surface")
        if self.result is not None and len(self.result) != self.sequence.intervals:
            raise ValueError(
                f"it has {len(self.result)} fields; expected {self.sequence.intervals}"
            )

    @property
    def is_complete(self) -> bool:
        return self.result is not None and bool(self.result.solved.all())

    def view_of_result(self, view: View) -> View:
        """Return a view that shows tracks and arrows of the result.

        If the view shows the flow already, arrows are not added. If there is no flow, or the user
        switched off showing it after matches, the view stays the same.
        """
        found = self.result
        if found is None or not (view.flow_after_match and found.velocity.any()):
            return view
        shows_no_flow = not (view.arrows or view.streaks) and view.coloring == "function"
        return replace(view, tracks=True, arrows=view.arrows or shows_no_flow)

    def unsaved_text(self, changes: Collection[str], has_new_result: bool) -> str:
        if self.result is not None and "result" in changes:
            return f"The sequence {self.name} and its fields are not saved."
        changed = ", ".join(words for name, words in _SEQUENCE_PARTS.items() if name in changes)
        return f"Not saved of the sequence {self.name}: {changed or 'changes'}."

    @property
    def large_parts(self) -> tuple[object, ...]:
        found = (self.sequence.frames, *(() if self.result is None else (self.result,)))
        return (*super().large_parts, *found)


def document_on(surfaces: tuple[Surface, ...], **values: Any) -> MatchDocument:
    kind = MatchDocument if len(surfaces) == 1 else PairDocument
    return kind(surfaces, **values)


KINDS: Mapping[str, type[Document]] = {
    "match": MatchDocument,
    "pair": PairDocument,
    "sequence": SequenceDocument,
}
"""Kinds of documents by their names in project files."""

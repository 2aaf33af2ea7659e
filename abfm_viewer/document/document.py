"""What all documents are made of: immutable, so that undo, saving and pictures share them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from itertools import compress
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np

from abfm import Parameters, TriangleMesh
from abfm.pages.front import Front, Triple, best_front
from abfm.types import BoolArray, FloatArray, IntArray
from abfm_viewer.document.comparison import Comparison
from abfm_viewer.document.label_map import LabelMap

if TYPE_CHECKING:  # a document without a result does not load its type
    from abfm import Correspondence, Match, Registration, Sequence

Side = Literal["source", "target"]
Theme = Literal["light", "dark"]
Layout = Literal["automatic", "row", "column", "advected only"]
Coloring = Literal[
    "function",
    "speed",
    "divergence",
    "curl",
    "coordinates",
    "checker",
    "labels",
    "area distortion",
    "conformal distortion",
]
FieldPart = Literal[
    "whole", "curl-free", "divergence-free", "harmonic", "commuting", "carried gradient"
]
ClickTool = Literal["nothing", "landmark", "flow line", "follow a point"]

TRANSFERRED_COLORINGS: tuple[Coloring, ...] = ("coordinates", "checker", "labels")
"""What shows where on the source's surface each point comes from."""
SIDES: tuple[Side, ...] = get_args(Side)
THEMES: tuple[Theme, ...] = get_args(Theme)
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
HODGE_PARTS: tuple[FieldPart, ...] = ("curl-free", "divergence-free", "harmonic")
FIELD_PARTS: tuple[FieldPart, ...] = get_args(FieldPart)
CLICK_TOOLS: tuple[ClickTool, ...] = get_args(ClickTool)
DEFAULT_PARAMETERS = Parameters()
EXTRAPOLATION = 2.0
"""The time bar goes to this many times tau."""
ZOOM_MAX = 200.0
ZOOM_MIN = 0.2
"""Zooms."""


class Range(NamedTuple):
    """The values that a number of a document may have in files."""

    low: float
    high: float = math.inf
    is_above: bool = False  # more than `low`

    def has(self, value: float) -> bool:
        return self.low <= value <= self.high and not (self.is_above and value == self.low)

    def __str__(self) -> str:
        bounds = f"{self.low:g} to {self.high:g}"
        return f"above {bounds}" if self.is_above else bounds


@dataclass(frozen=True)
class Channel:
    """A source and a target as specs of `abfm.functions`, and the weight of their mismatch."""

    source: str
    target: str
    weight: Annotated[float, Range(0)] = 1.0

    @property
    def specs(self) -> tuple[str, str]:
        return self.source, self.target

    def spec(self, side: Side) -> str:
        return self.source if side == "source" else self.target

    def changed(self, side: Side, spec: str) -> Channel:
        return replace(self, source=spec) if side == "source" else replace(self, target=spec)


@dataclass(frozen=True)
class Point:
    """A point of the surface: a face (of the mesh, not the file) and its barycentric weights."""

    face: int
    barycentric: Triple


@dataclass(frozen=True)
class Landmark:
    """A point of the source's surface and the point of the target's that it belongs to; None where
    it was not placed yet.
    """

    source: Point | None = None
    target: Point | None = None
    weight: Annotated[float, Range(0, is_above=True)] = 1.0
    name: str = ""  # as a file calls it

    def point(self, side: Side) -> Point | None:
        return self.source if side == "source" else self.target

    def placed(self, side: Side, point: Point) -> Landmark:
        return replace(self, source=point) if side == "source" else replace(self, target=point)

    @property
    def is_complete(self) -> bool:
        return self.source is not None and self.target is not None


@dataclass(frozen=True)
class Viewpoint:
    """How every surface is seen in its slot; a zoom of 1 fits it from every side.

    The target (3,), in the mesh's units, by default the middle of what the view's front shows, is
    in the slot's middle and stays there when the surface turns.
    """

    front: Front
    zoom: Annotated[float, Range(ZOOM_MIN, ZOOM_MAX)] = 1.0
    target: Triple | None = None


@dataclass(frozen=True)
class Surface:
    """A mesh and the name of its file; the `front`, None until chosen, makes it no other one."""

    mesh: TriangleMesh
    name: str
    front: Front | None = field(default=None, compare=False)


@dataclass(frozen=True)
class MapRequest:
    """What an initial map, and what is matched by it, are found for."""

    word: str
    channels: tuple[Channel, ...]
    mask: str
    landmarks: tuple[Landmark, ...]
    landmarks_alone: bool


@dataclass(frozen=True)
class InitialMap:
    """The map by which a result's functions came from surface A to surface B, what is worth knowing
    of it, and what it was found for.
    """

    correspondence: Correspondence
    request: MapRequest
    notes: tuple[str, ...] = ()
    # A's, (V_A, C), as they are compared; None where they are known on B alone
    functions: FloatArray | None = field(default=None, compare=False)
    warnings: tuple[str, ...] = ()  # why it may lead elsewhere

    def registration(self, match: Match) -> Registration:
        """Return the registration of a match that began with this map, made once."""
        from abfm import Registration  # with all that it loads

        found: Registration | None = vars(self).get("_registration")
        if found is None or found.match is not match:
            parts = self.correspondence, match, self.notes, self.functions, self.warnings
            found = vars(self)["_registration"] = Registration(*parts)
        return found

    def is_for(self, document: Document) -> bool:
        """Return whether a document still has what it was found for."""
        return self.request == document.map_request


@dataclass(frozen=True)
class Function:
    """A function on a surface by its spec: a side of a channel, or the mask."""

    surface: Surface
    spec: str


@dataclass(frozen=True)
class ViewPreferences:
    """What stays of a view when another document is opened."""

    theme: Theme = "light"
    ui_scale: Annotated[float, Range(0, 10, is_above=True)] = 1.0
    layout: Layout = "automatic"
    colormap: str = "automatic"  # by the functions' signs; or one of `appearance.colormaps.NAMES`
    isolines: bool = False
    isoline_count: Annotated[int, Range(1, 1000)] = 12
    color_bar: bool = True
    wireframe: bool = False
    flat: bool = False  # each face in one shade
    # a match that was found on a finer mesh shows its functions there, without streaks
    finer: bool = False
    # what the longest may have, of sqrt(area)
    arrow_length: Annotated[float, Range(0, 10, is_above=True)] = 0.12
    arrow_density: Annotated[float, Range(0, 1)] = 0.5  # from few to many
    flow_after_match: bool = True  # whether a match that ended shows its flow and plays it
    previous_runs: bool = True  # whether the plot of residuals shows them
    # whether residuals of steps are plotted against their distortion, during a run and after it
    trade_off_live: bool = False
    trade_off: bool = True


@dataclass(frozen=True)
class View(ViewPreferences):
    """Everything that decides how the document is drawn, and nothing of what is solved."""

    viewpoint: Viewpoint | None = None  # from the surface's front, fitted
    enlarged: str = ""  # the slot that has the others' room, too
    hidden: tuple[str, ...] = ()  # surfaces
    coloring: Coloring = "function"  # of the advected surface
    blend: bool = False  # whether there is a surface for it, as for the next two
    transport: bool = False
    error: bool = False
    links: bool = False  # lines from points of surface A to where they are on B
    arrows: bool = False
    # of the field that is drawn, coloured and traced, or a field that belongs to it
    part: FieldPart = "whole"
    tracks: bool = False  # ways of a film's critical points
    streaks: bool = False  # on the advected surface
    fade: bool = False  # streaks, where the field is slow
    animate: bool = False  # streaks move along the field
    tool: ClickTool = "nothing"
    speeds: bool = False  # whether a film's plot shows speeds instead of residuals

    @property
    def preferences(self) -> View:
        """Return a view that has the user's preferences and nothing of what is shown."""
        return View(**{one.name: getattr(self, one.name) for one in fields(ViewPreferences)})

    @property
    def surfaces(self) -> tuple[str, ...]:
        wanted = (self.blend, self.transport, self.error)
        extra = compress(("linear blend", "optimal transport", "error"), wanted)
        if self.layout == "advected only":
            return ("advected", *extra)
        return ("source", "advected", *extra, "target")

    @property
    def shown_surfaces(self) -> tuple[str, ...]:
        """Return those that are not hidden; where all are, the advected one."""
        return tuple(name for name in self.surfaces if name not in self.hidden) or ("advected",)


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The energy of one run; vertices of each row's mesh, reaches, residuals and sigmas (n,) are
    empty if unknown.
    """

    energies: FloatArray  # (n, 3): total, regularity and mismatch
    stages: IntArray  # (n,)
    # rows at which a changed problem started the solver again from the field that it had
    restarts: tuple[int, ...]
    residual: float  # the least of its fields; 0 while it runs
    label: str  # what was solved, in a few words
    vertices: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    reaches: FloatArray = field(default_factory=lambda: np.zeros(0))
    term_names: tuple[str, ...] = ()  # of the data terms, where there are T > 1
    shares: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # (n, T), of the mismatch
    residuals: FloatArray = field(default_factory=lambda: np.zeros(0))
    sigmas: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def has_mesh_sizes(self) -> bool:
        return len(self.vertices) > 0

    @property
    def curves(self) -> dict[str, FloatArray]:
        """The total and all terms, (n,), by the words of the window."""
        total, regularity, mismatch = self.energies.T
        terms = dict(zip(self.term_names, self.shares.T, strict=True)) or {"closeness": mismatch}
        return {"energy": total, "smoothness": regularity} | terms

    @property
    def residual_curve(self) -> FloatArray:
        """The residuals (n,); where they are unknown, by the energy, whose unit is each stage's: a
        stage goes on where the one before ended, and the last one ends at the run's residual.
        """
        if len(self.residuals) or not len(self.stages):
            return self.residuals
        roots = np.log(np.maximum(self.energies[:, 2], np.finfo(float).tiny)) / 2
        falls = np.where(np.diff(self.stages) == 0, np.diff(roots), 0.0)
        found: FloatArray = self.residual * np.exp(np.cumsum([0, *falls]) - falls.sum())
        return found

    @property
    def best_residuals(self) -> FloatArray:
        """The least that was left so far (n,), which rises only where the problem changed; never
        less than what a field leaves that the run gave: on coarser meshes it may be less.
        """
        parts = np.split(
            self.residual_curve, [row for row in self.restarts if row < len(self.stages)]
        )
        least = [np.fmin.accumulate(part) for part in parts]
        return np.concatenate([*least[:-1], np.maximum(least[-1], self.residual)])


Values = Callable[[Function], FloatArray | None]
"""The values (V,) of a function; None before they are known."""
Missing = tuple[tuple[object, ...], Callable[[], BoolArray | None]]
"""What decides where a function has no values, and what finds it, (V,); None for nowhere."""
Ranged = tuple[tuple[object, ...], Callable[[], tuple[FloatArray, ...]]]
"""What decides the range of functions that are shown, and what finds values of that range."""


class Identity:
    """What stays the same of a document while it is edited; equal only to itself."""


@dataclass(frozen=True, eq=False)
class Document:
    """A state of the session that undo returns to and a project file keeps.

    `kinds.py` has the kinds of documents. A question that a view asks of all of them has here the
    answer of those that have nothing of the sort.
    """

    match_label: ClassVar[str] = "Match"
    """Label of the button that starts a run; its tip, and that of the button that ends it."""
    match_tip: ClassVar[str] = (
        "Find the field whose flow carries the source to the target (Ctrl+Enter)."
    )
    cancel_tip: ClassVar[str] = (
        "End the run and keep the best field so far (Esc); Continue goes on from it."
    )
    play_tips: ClassVar[tuple[str, ...]] = (
        "Show the function on its way (Space).",
        "A twentieth of τ back.",
        "A twentieth of τ on.",
        "Show the source, time 0.",
    )
    """Tips of the buttons that play, step back, step on and go to the start."""
    speed_tip: ClassVar[str] = "1 goes from 0 to τ in four seconds."
    extrapolates: ClassVar[bool] = True
    """Whether times after the last one with a target can be shown."""
    has_one_field: ClassVar[bool] = True
    """Whether one flow is shown at all times, so that playing waits for all of it."""
    has_sides: ClassVar[bool] = True
    """Whether Gaussians and landmarks can be placed on a source and a target."""
    content_fields: ClassVar[tuple[str, ...]] = ("labels", "lines", "points")
    """Fields that are lost if they are in no file, besides the result; view and time are not."""
    exported_fields: ClassVar[tuple[str, ...]] = ()
    """Fields that are in a file of the result."""
    surface_count: ClassVar[int] = 1

    surfaces: tuple[Surface, ...]  # the only one, or A and B
    _: KW_ONLY
    channel: int = 0  # the active one
    labels: LabelMap | None = None  # of the source's surface
    time: float = 0.0  # shown, from `start` to `end`
    lines: tuple[Point, ...] = ()  # where flow lines start
    points: tuple[Point, ...] = ()  # that are followed, at time 0
    view: View = field(default_factory=View)
    identity: Identity = field(default_factory=Identity)

    # Answers of documents without functions by specs, and without a match

    @property
    def channels(self) -> tuple[Channel, ...]:
        return ()

    @property
    def parameters(self) -> Parameters:
        return DEFAULT_PARAMETERS

    @property
    def mask(self) -> str:
        """Spec of the weight of the mismatch at each vertex; empty for none."""
        return ""

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        return ()

    @property
    def pairs(self) -> tuple[Landmark, ...]:
        """Landmarks that are placed on both sides, which are matched."""
        return tuple(landmark for landmark in self.landmarks if landmark.is_complete)

    @property
    def result(self) -> Match | Sequence | None:
        return None

    @property
    def map_request(self) -> MapRequest:
        return MapRequest("", self.channels, self.mask, self.pairs, False)

    @property
    def runs(self) -> tuple[RunRecord, ...]:
        """Those that ended, the latest last."""
        return ()

    @property
    def match(self) -> Match | None:
        """The result, if it is of two functions."""
        return None

    @property
    def initial_map(self) -> InitialMap | None:
        """The map that the result began with, of two surfaces."""
        return None

    @property
    def active_comparison(self) -> Comparison | None:
        """The comparison of a subject with its population that the active channel is of."""
        return None

    @property
    def sequence_result(self) -> Sequence | None:
        """The result, if critical points of its fields can be followed."""
        return None

    @property
    def channel_count(self) -> int:
        return max(len(self.channels), 1)

    @property
    def active(self) -> Channel | None:
        return self.channels[self.channel] if self.channels else None

    @property
    def functions(self) -> tuple[Function, ...]:
        """All that are evaluated."""
        return ()

    # Surfaces, their names and their fronts

    @property
    def name(self) -> str:
        return self.surface().name

    def surface(self, slot: str = "advected") -> Surface:
        """The surface that a slot shows, on which a side's functions are: of two, the source is on
        A, and all else, as the flow, on B.
        """
        return self.surfaces[0 if slot == "source" else -1]

    def slot_title(self, slot: str) -> str:
        """A slot's name."""
        return slot

    def transferred_title(self, kind: str) -> str:
        """The title of what is carried from the source's surface."""
        return f"carried {kind}"

    def surface_label(self, side: Side) -> str:
        """What a side's surface is called."""
        return side

    def renamed(self, name: str, called: Mapping[str, str]) -> Self:
        """Return it called by another name, and its functions by names by their specs."""
        *others, last = self.surfaces
        return replace(self, surfaces=(*others, replace(last, name=name)))

    def facing(self, front: Front, slot: str = "advected") -> Self:
        """Return it with the surface of a slot seen from another side."""
        seen = self.surface(slot)
        surfaces = (replace(one, front=front) if one is seen else one for one in self.surfaces)
        return replace(self, surfaces=tuple(surfaces))

    def front(self, slot: str, *functions: FloatArray, up: str | None = None) -> Front:
        """The side from which most is seen of the functions on a slot's surface."""
        return best_front(self.surface(slot).mesh, *functions, up=up)

    def values_key(self, side: Side, spec: str) -> str:
        """Return the name of a function's values from files: of two surfaces, A's have a prefix."""
        return spec

    def values_on(self, side: Side, known: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return those values, by their names, that are of a side's surface, by specs."""
        return dict(known)

    def missing_values(self, slot: str, values: Values) -> Missing:
        """Return where a slot's function has no values."""
        return (), lambda: None

    def color_range_values(self, source: FloatArray, target: FloatArray) -> Ranged:
        """Return the values whose range colours have."""
        return (source, target), lambda: (source, target)

    # Times

    @property
    def start(self) -> float:
        return 0.0

    @property
    def end(self) -> float:
        return EXTRAPOLATION * self.parameters.tau

    @property
    def last_target_time(self) -> float:
        """The time at which the last target is reached."""
        return self.parameters.tau

    @property
    def flow_time(self) -> float:
        """The shown time in the flow that is shown."""
        return self.time

    @property
    def tau(self) -> float:
        """How long the flow that is shown takes."""
        return self.parameters.tau

    @property
    def interval(self) -> int:
        """Which flow is shown, of several."""
        return 0

    @property
    def ticks(self) -> tuple[float, ...]:
        """Times of frames."""
        return ()

    def time_after(self, share: float) -> float:
        """The time a step later, or earlier if negative: a share of tau."""
        return self.time + share * self.parameters.tau

    @property
    def time_range_label(self) -> str:
        """Which times can be shown, in a few words."""
        return "0 to 2τ"

    @property
    def slider_tip(self) -> str:
        """Tip of the time bar's slider."""
        return "0 is the source, τ the match; beyond, the flow goes on by itself."

    @property
    def time_range_text(self) -> str:
        """Say which times can be shown."""
        beyond = f", which is {EXTRAPOLATION:g} tau" if self.extrapolates else ""
        return f"{self.start:g} to {self.end:g}{beyond}"

    # The result

    @property
    def is_outdated(self) -> bool:
        """Whether the document alone tells that its result is of something else."""
        return False

    def check(self) -> None:
        """Raise a ValueError if fields do not fit together."""

    @property
    def complete_result(self) -> Any:
        """The result with everything that its file holds."""
        return self.result

    def saved(self) -> Document:
        """Return the document that a project of it opens as."""
        return self

    @property
    def is_complete(self) -> bool:
        """Whether a run of it would find nothing more."""
        return False

    def view_of_result(self, view: View) -> View:
        """Return the view in which a result that was opened is seen."""
        return view

    def unsaved_text(self, changes: Collection[str], has_new_result: bool) -> str:
        """Say what of it is in no file, for the fields that changed."""
        return f"{self.name} has changes that are in no file."

    @property
    def large_parts(self) -> tuple[object, ...]:
        """Parts whose arrays take room in the history."""
        return tuple(surface.mesh for surface in self.surfaces)

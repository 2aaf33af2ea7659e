"""Base class of documents, and the parts of which documents consist.

Documents are immutable, so undo, saving and pictures can share them. Surface A or B: if two
surfaces are registered, the source is on A and the target on B. Side: source or target. Slot: one
of the pictures side by side. Spec: the text that defines a function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from itertools import compress
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np

from abfm import Parameters, TriangleMesh
from abfm.display import ViewSpec
from abfm.pages.front import Front, Triple, front_of
from abfm.types import BoolArray, FloatArray, IntArray
from abfm_viewer.document.comparison import Comparison
from abfm_viewer.document.keyboard import hint
from abfm_viewer.document.label_map import LabelMap

if TYPE_CHECKING:  # documents without a result do not load the types of results
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
    "complete", "curl-free", "divergence-free", "harmonic", "commuting", "pushed gradient"
]
ClickTool = Literal["nothing", "landmark", "flow line", "follow a point"]

TRANSFERRED_COLORINGS: tuple[Coloring, ...] = ("coordinates", "checker", "labels")
"""Colourings that show to which point of the source's surface each point belongs."""
SIDES: tuple[Side, ...] = get_args(Side)
THEMES: tuple[Theme, ...] = get_args(Theme)
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
HODGE_PARTS: tuple[FieldPart, ...] = ("curl-free", "divergence-free", "harmonic")
FIELD_PARTS: tuple[FieldPart, ...] = get_args(FieldPart)
CLICK_TOOLS: tuple[ClickTool, ...] = get_args(ClickTool)
APPEARANCE = ("theme", "ui_scale")
"""Settings of the view that belong to the user, and to no document or step of undo."""
DEFAULT_PARAMETERS = Parameters()
EXTRAPOLATION = 2.0  # end of the time bar as a multiple of tau
ZOOM_MIN = 0.2
ZOOM_MAX = 200.0
"""Smallest and largest zoom."""


class Range(NamedTuple):
    """Range of the values that are allowed for a number of a document."""

    low: float
    high: float = math.inf
    excludes_low: bool = False

    def contains(self, value: float) -> bool:
        return self.low <= value <= self.high and not (self.excludes_low and value == self.low)

    def __str__(self) -> str:
        bounds = f"{self.low:g} to {self.high:g}"
        return f"above {bounds}" if self.excludes_low else bounds


@dataclass(frozen=True)
class Channel:
    """A pair of functions to match, and the weight of their mismatch.

    Functions are given as texts (specs), see `abfm.functions`.
    """

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
    """Point of a surface: face number in the mesh (not in the file) and barycentric weights."""

    face: int
    barycentric: Triple


@dataclass(frozen=True)
class Landmark:
    """Pair of corresponding points on source and target surface; a point is None if not placed."""

    source: Point | None = None
    target: Point | None = None
    weight: Annotated[float, Range(0, excludes_low=True)] = 1.0
    name: str = ""  # from the landmark file

    def point(self, side: Side) -> Point | None:
        return self.source if side == "source" else self.target

    def placed(self, side: Side, point: Point) -> Landmark:
        return replace(self, source=point) if side == "source" else replace(self, target=point)

    @property
    def is_complete(self) -> bool:
        return self.source is not None and self.target is not None


@dataclass(frozen=True)
class Viewpoint:
    """Direction and zoom with which surfaces are shown, each in its slot (its part of the window).

    At a zoom of 1 the surface fits into the slot from every direction. The point `target` (3,), in
    the units of the mesh, is shown in the middle of the slot and stays there during rotation. By
    default it is the middle of the part that is visible from the front.
    """

    front: Front
    zoom: Annotated[float, Range(ZOOM_MIN, ZOOM_MAX)] = 1.0
    target: Triple | None = None


@dataclass(frozen=True)
class Surface:
    """A mesh, the name of its file, and its front (the side shown first), which is not compared."""

    mesh: TriangleMesh
    name: str
    front: Front | None = field(default=None, compare=False)  # None until it is chosen


@dataclass(frozen=True)
class MapRequest:
    """Inputs that determine the initial map between two surfaces, and the problem on surface B."""

    word: str
    channels: tuple[Channel, ...]
    mask: str
    landmarks: tuple[Landmark, ...]
    landmarks_alone: bool


@dataclass(frozen=True)
class InitialMap:
    """Initial map by which the functions of surface A are transferred to surface B."""

    correspondence: Correspondence
    request: MapRequest  # for which the map was computed
    notes: tuple[str, ...] = ()
    # functions on A, (V_A, C), scaled as in the match; None if they are known on B alone
    functions: FloatArray | None = field(default=None, compare=False)
    warnings: tuple[str, ...] = ()  # reasons why the map may be wrong

    def registration(self, match: Match) -> Registration:
        """Return the registration of this map and a match; the same match gives the same object."""
        from abfm import Registration  # imported late: loads many modules

        found: Registration | None = vars(self).get("_registration")
        if found is None or found.match is not match:
            parts = self.correspondence, match, self.notes, self.functions, self.warnings
            found = vars(self)["_registration"] = Registration(*parts)
        return found

    def is_for(self, document: Document) -> bool:
        return self.request == document.map_request


@dataclass(frozen=True)
class Function:
    """One function of a document (a source, target or mask): its surface and its spec, a text."""

    surface: Surface
    spec: str


@dataclass(frozen=True)
class ViewPreferences:
    """Settings of the view that stay when another document is opened."""

    theme: Theme = "light"
    ui_scale: Annotated[float, Range(0, 10, excludes_low=True)] = 1.0
    layout: Layout = "automatic"
    # one of `abfm.pages.colormaps.NAMES`, or "automatic": chosen by the signs of the functions
    colormap: str = "automatic"
    full_range: bool = False  # whether colours show all values, also if few stretch the range
    isolines: bool = False
    isoline_count: Annotated[int, Range(1, 1000)] = 12
    color_bar: bool = True
    wireframe: bool = False
    flat: bool = False  # flat shading
    # show the functions of a match on its finer mesh, if it has one; without streaks
    finer: bool = False
    # length of the longest arrow, as a fraction of sqrt(area)
    arrow_length: Annotated[float, Range(0, 10, excludes_low=True)] = 0.12
    arrow_density: Annotated[float, Range(0, 1)] = 0.5
    fade_uncertain: bool = True  # make the field faint where the data do not determine it
    flow_after_match: bool = True  # show and play the flow when a match ends
    previous_runs: bool = True  # show earlier runs in the plot of residuals
    # plot the residuals of steps against their distortion: during a run, and after it
    trade_off_live: bool = False
    trade_off: bool = True


@dataclass(frozen=True)
class View(ViewPreferences):
    """All settings that affect how a document is drawn, and none that affect the match."""

    viewpoint: Viewpoint | None = None  # None: from the front, at zoom 1
    enlarged: str = ""  # the only slot that is shown; empty: all slots
    hidden: tuple[str, ...] = ()  # names of hidden surfaces
    coloring: Coloring = "function"  # of the advected surface
    blend: bool = False  # show a surface with the linear blend
    transport: bool = False  # show a surface with the optimal transport
    error: bool = False  # show a surface with the error
    links: bool = False  # lines from points of surface A to their images on B
    arrows: bool = False
    # the field for arrows, streaks, colours and flow lines: all, a part, or a related field
    part: FieldPart = "complete"
    tracks: bool = False  # paths of the critical points of a sequence
    streaks: bool = False  # on the advected surface
    fade: bool = False  # make streaks fainter where the field is slow
    animate: bool = False  # move the streaks along the field
    tool: ClickTool = "nothing"
    speeds: bool = False  # plot the speeds of a sequence instead of the residuals

    def with_appearance(self, theme: Theme, ui_scale: float) -> View:
        """View with other values of the `APPEARANCE`; the same object if they are the same."""
        same = (theme, ui_scale) == (self.theme, self.ui_scale)
        return self if same else replace(self, theme=theme, ui_scale=ui_scale)

    @property
    def appearance(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in APPEARANCE}

    @property
    def preferences(self) -> View:
        """View with the same `ViewPreferences`, and default values for all other settings."""
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
        """Names of the surfaces that are not hidden; the advected one if all are hidden."""
        return tuple(name for name in self.surfaces if name not in self.hidden) or ("advected",)


@dataclass(frozen=True, eq=False)
class RunRecord:
    """Energies of one run of the solver, one row for each of its n iterations.

    Vertex counts, residuals, sigmas, reaches (distances over which functions are compared, in
    sqrt(area)) and attempts have shape (n,), and are empty if unknown. Attempts are counted from 1.
    """

    energies: FloatArray  # (n, 3): total, regularity and mismatch
    stages: IntArray  # (n,), number of the stage
    # rows at which the solver continued with a changed problem
    restarts: tuple[int, ...]
    residual: float  # of the result; 0 while there is none
    label: str  # the parameters in short
    vertices: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    reaches: FloatArray = field(default_factory=lambda: np.zeros(0))
    term_names: tuple[str, ...] = ()  # names of the T data terms if T > 1
    shares: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # (n, T), their energies
    residuals: FloatArray = field(default_factory=lambda: np.zeros(0))
    sigmas: FloatArray = field(default_factory=lambda: np.zeros(0))
    attempts: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def iterations(self) -> int:
        return max(len(self.stages) - 1, 0)

    @property
    def has_mesh_sizes(self) -> bool:
        return len(self.vertices) > 0

    @property
    def curves(self) -> dict[str, FloatArray]:
        """Total energy and its terms, (n,) each, by their names in the window."""
        total, regularity, mismatch = self.energies.T
        terms = dict(zip(self.term_names, self.shares.T, strict=True)) or {"closeness": mismatch}
        return {"energy": total, "smoothness": regularity} | terms

    @property
    def residual_curve(self) -> FloatArray:
        """Residuals of the iterations, (n,), estimated from the energies if they are unknown.

        The scale of the energy differs between stages. So the estimate of each stage starts where
        the previous stage ended, and the last stage ends at the residual of the run.
        """
        if len(self.residuals) or not len(self.stages):
            return self.residuals
        roots = np.log(np.maximum(self.energies[:, 2], np.finfo(float).tiny)) / 2
        falls = np.where(np.diff(self.stages) == 0, np.diff(roots), 0.0)
        return np.asarray(self.residual * np.exp(np.cumsum([0, *falls]) - falls.sum()))

    @property
    def best_residuals(self) -> FloatArray:
        """Smallest residual up to each iteration, (n,), found anew after changes of the problem.

        After the last change of the problem, values are at least the residual of the run. Iterates
        on coarser meshes may have smaller residuals, but their fields are not the result.
        """
        restarts = [row for row in self.restarts if row < len(self.stages)]
        parts = np.split(self.residual_curve, restarts)
        best = [np.fmin.accumulate(part) for part in parts]
        return np.concatenate([*best[:-1], np.maximum(best[-1], self.residual)])


Values = Callable[[Function], FloatArray | None]
"""Returns the values (V,) of a function; None until they are computed."""
MissingValues = tuple[tuple[object, ...], Callable[[], BoolArray | None]]
"""A cache key and a function that finds the mask (V,) of missing values, or None."""
RangeValues = tuple[tuple[object, ...], Callable[[], tuple[FloatArray, ...]]]
"""A cache key and a function that returns the values whose range the colours cover."""


class Identity:
    """Identity of a document, which all its edited states share; it is equal only to itself."""


@dataclass(frozen=True, eq=False)
class Document:
    """The user's input, the result and the view, as stored in the history and in project files.

    Subclasses for the kinds of documents are in `kinds.py`. The defaults here are for kinds that do
    not have the feature.
    """

    match_label: ClassVar[str] = "Match"
    """Label of the button that starts a run."""
    match_tip: ClassVar[str] = "Find the field whose flow advects the source to the target."
    """Tooltip of the button that starts a run."""
    cancel_tip: ClassVar[str] = (
        f"End the run and keep the best field so far ({hint('cancel')}). Continue resumes from it."
    )
    """Tooltip of the button that ends a run."""
    play_tips: ClassVar[tuple[str, ...]] = (
        "Play the flow from the source to the target.",
        "Go back by τ/20.",
        "Go forward by τ/20.",
        "Show the source, time 0.",
    )
    """Tooltips of the buttons for play, step back, step forward and start."""
    speed_tip: ClassVar[str] = "Playing speed: at 1 the flow takes four seconds from 0 to τ."
    extrapolates: ClassVar[bool] = True  # whether times after the last target can be shown
    has_one_field: ClassVar[bool] = True
    """Whether the same flow is shown at all times; playing then waits for the complete flow."""
    has_sides: ClassVar[bool] = True
    """Whether Gaussians and landmarks can be placed on a source and a target."""
    content_fields: ClassVar[tuple[str, ...]] = ("labels", "lines", "points")
    """Names of fields that count as unsaved changes, besides the result."""
    exported_fields: ClassVar[tuple[str, ...]] = ()  # names of fields that a result file contains
    surface_count: ClassVar[int] = 1

    surfaces: tuple[Surface, ...]  # the only surface, or A and B
    _: KW_ONLY
    channel: int = 0  # number of the active channel
    labels: LabelMap | None = None  # of the source's surface
    time: float = 0.0  # shown time, from `start` to `end`
    lines: tuple[Point, ...] = ()  # start points of flow lines
    points: tuple[Point, ...] = ()  # positions at time 0 of points that follow the flow
    view: View = field(default_factory=View)
    identity: Identity = field(default_factory=Identity)

    @property
    def channels(self) -> tuple[Channel, ...]:
        return ()

    @property
    def parameters(self) -> Parameters:
        return DEFAULT_PARAMETERS

    @property
    def mask(self) -> str:
        """Spec (text) of the mask, which weights the mismatch at each vertex; empty for none."""
        return ""

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        return ()

    @property
    def pairs(self) -> tuple[Landmark, ...]:
        """Landmarks with points on both surfaces; only these are matched."""
        return tuple(landmark for landmark in self.landmarks if landmark.is_complete)

    @property
    def result(self) -> Match | Sequence | None:
        return None

    @property
    def map_request(self) -> MapRequest:
        return MapRequest("", self.channels, self.mask, self.pairs, False)

    @property
    def runs(self) -> tuple[RunRecord, ...]:
        """Records of all runs of the solver that ended, the latest last."""
        return ()

    @property
    def match(self) -> Match | None:
        return None

    @property
    def initial_map(self) -> InitialMap | None:
        return None

    @property
    def active_comparison(self) -> Comparison | None:
        """Comparison of a subject with its population, for the active channel; None without one."""
        return None

    @property
    def sequence_result(self) -> Sequence | None:
        """The result if it is a sequence, whose critical points can be followed; otherwise None."""
        return None

    @property
    def channel_count(self) -> int:
        return max(len(self.channels), 1)

    @property
    def active(self) -> Channel | None:
        return self.channels[self.channel] if self.channels else None

    @property
    def functions(self) -> tuple[Function, ...]:
        return ()

    @property
    def name(self) -> str:
        return self.surface().name

    def surface(self, slot: str = "advected") -> Surface:
        """Return the surface of a side (source or target) or of a slot (a picture in the window).

        Of two surfaces, the source is on A; everything else, including the flow, is on B.
        """
        return self.surfaces[0 if slot == "source" else -1]

    def slot_title(self, slot: str) -> str:
        return slot

    def transferred_title(self, kind: str) -> str:
        """Return the title of labels or colours (``kind``) that the flow moves from the source."""
        return f"advected {kind}"

    def surface_label(self, side: Side) -> str:
        return side

    def renamed(self, name: str, display_names: Mapping[str, str]) -> Self:
        *others, last = self.surfaces
        return replace(self, surfaces=(*others, replace(last, name=name)))

    def front(self, view: ViewSpec, *functions: FloatArray) -> Front:
        """Return the side from which the last surface is shown, which has these functions."""
        return front_of(self.surface().mesh, *functions, view=view)

    def facing(self, view: ViewSpec, *functions: FloatArray) -> Self:
        """Return the document seen from a side; the last surface has these functions (V,)."""
        *others, last = self.surfaces
        last = replace(last, front=self.front(view, *functions))
        found = replace(self, surfaces=(*others, last))
        return replace(found, view=replace(found.view, viewpoint=None))

    def values_key(self, side: Side, spec: str) -> str:
        """Return a function's key in a project: its spec, with a prefix if on A of two surfaces."""
        return spec

    def values_on(self, side: Side, known: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return dict(known)

    def missing_values(self, slot: str, values: Values) -> MissingValues:
        """Return a cache key, and a function that finds missing values in a slot (a picture)."""
        return (), lambda: None

    def color_range_values(self, source: FloatArray, target: FloatArray) -> RangeValues:
        """Return a cache key, and a function that returns the values whose range is coloured."""
        return (source, target), lambda: (source, target)

    @property
    def start(self) -> float:
        return 0.0

    @property
    def end(self) -> float:
        return EXTRAPOLATION * self.parameters.tau

    @property
    def last_target_time(self) -> float:
        return self.parameters.tau

    @property
    def flow_time(self) -> float:
        """Shown time, relative to the start of the shown flow (the interval, in a sequence)."""
        return self.time

    @property
    def tau(self) -> float:
        return self.parameters.tau

    @property
    def interval(self) -> int:
        """Number of the interval (between two frames) whose flow is shown; 0 without frames."""
        return 0

    @property
    def ticks(self) -> tuple[float, ...]:
        """Times of the frames of a sequence, marked in the time bar; empty without frames."""
        return ()

    def time_after(self, share: float) -> float:
        """Return the time that is ``share`` of tau after the shown time; negative shares go back.

        In a sequence it is the time of the next or previous frame.
        """
        return self.time + share * self.parameters.tau

    @property
    def time_range_label(self) -> str:
        return "0 to 2τ"

    @property
    def slider_tip(self) -> str:
        return "0 is the source and τ the match. Beyond τ the flow is extrapolated."

    @property
    def time_range_text(self) -> str:
        """Text of the range of times that can be shown, such as "0 to 2, which is 2 tau"."""
        beyond = f", which is {EXTRAPOLATION:g} tau" if self.extrapolates else ""
        return f"{self.start:g} to {self.end:g}{beyond}"

    @property
    def is_outdated(self) -> bool:
        return False

    def check(self) -> None:
        """Raise a `ValueError` if fields of the document contradict each other."""

    @property
    def complete_result(self) -> Any:
        """The result with all that a result file contains; for two surfaces a registration."""
        return self.result

    def saved(self) -> Document:
        """Return the document that results from saving this one as a project and opening it."""
        return self

    @property
    def is_complete(self) -> bool:
        """Whether the result is complete, so that another run would add nothing."""
        return False

    def view_of_result(self, view: View) -> View:
        """Return a view in which the document's result, just opened or computed, is visible."""
        return view

    def unsaved_text(self, changes: Collection[str], has_new_result: bool) -> str:
        return f"{self.name} has unsaved changes."

    @property
    def large_parts(self) -> tuple[object, ...]:
        """Objects with large arrays, whose sizes count towards the memory limit of undo."""
        return tuple(surface.mesh for surface in self.surfaces)

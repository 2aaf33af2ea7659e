"""What a project holds: immutable, so that undo, saving and pictures all work on whole states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from abfm import Parameters, TriangleMesh
from abfm.pages.front import Front, Triple
from abfm.types import FloatArray, IntArray
from abfm_viewer.document.comparison import Comparison
from abfm_viewer.document.film import Film, FilmSettings, is_of
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

CARRIED: tuple[Coloring, ...] = ("coordinates", "checker", "labels")
"""What shows where on the source's surface each point comes from."""
COLORINGS: tuple[Coloring, ...] = get_args(Coloring)
SIDES: tuple[Side, ...] = get_args(Side)
THEMES: tuple[Theme, ...] = get_args(Theme)
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
HODGE_PARTS: tuple[FieldPart, ...] = ("curl-free", "divergence-free", "harmonic")
FIELD_PARTS: tuple[FieldPart, ...] = get_args(FieldPart)
CLICK_TOOLS: tuple[ClickTool, ...] = get_args(ClickTool)
EXTRAPOLATION = 2.0
"""The time bar goes to this many times tau."""
_PREFERENCES = (
    "theme",
    "ui_scale",
    "layout",
    "colormap",
    "isolines",
    "isoline_count",
    "color_bar",
    "wireframe",
    "flat",
    "finer",
    "arrow_length",
    "arrow_density",
    "flow_after_match",
    "previous_runs",
    "trade_off",
    "trade_off_live",
)
"""Attributes of a `View` that stay when another document is opened."""
NEAREST, FARTHEST = 200.0, 0.2
"""Zooms."""
MEASURED = "measured"
"""Column of a mask that is 0 where functions have no values, and were filled in."""
OF_A = "A: "
"""What names of values from files begin with that are of surface A of two."""


@dataclass(frozen=True)
class Channel:
    """A source and a target as specs of `abfm.functions`, and the weight of their mismatch."""

    source: str
    target: str
    weight: float = 1.0

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
    weight: float = 1.0
    name: str = ""  # as a file calls it

    def point(self, side: Side) -> Point | None:
        return self.source if side == "source" else self.target

    def placed(self, side: Side, point: Point) -> Landmark:
        return replace(self, source=point) if side == "source" else replace(self, target=point)

    @property
    def is_whole(self) -> bool:
        return self.source is not None and self.target is not None


@dataclass(frozen=True)
class Look:
    """How every surface is seen in its slot; a zoom of 1 fits it from every side.

    The target (3,), in the mesh's units, by default the middle of what the view's front shows, is
    in the slot's middle and stays there when the surface turns.
    """

    front: Front
    zoom: float = 1.0
    target: Triple | None = None


@dataclass(frozen=True)
class Surface:
    """A mesh and the name of its file; the `front`, None until chosen, makes it no other one."""

    mesh: TriangleMesh
    name: str
    front: Front | None = field(default=None, compare=False)


class Asked(NamedTuple):
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
    word: str
    channels: tuple[Channel, ...]
    mask: str
    notes: tuple[str, ...] = ()
    landmarks: tuple[Landmark, ...] = ()
    landmarks_alone: bool = False
    # A's, (V_A, C), as they are compared; None where they are known on B alone
    functions: FloatArray | None = field(default=None, compare=False)
    warnings: tuple[str, ...] = ()  # why it may lead elsewhere

    def registration(self, match: Match) -> Registration:
        """Return the registration of a match that began with this map."""
        from abfm import Registration  # with all that it loads

        return Registration(self.correspondence, match, self.notes, self.functions, self.warnings)

    @property
    def asked(self) -> Asked:
        return Asked(self.word, self.channels, self.mask, self.landmarks, self.landmarks_alone)

    def is_for(self, document: Document) -> bool:
        """Return whether a document still has what it was found for."""
        return self.asked == document.asked


@dataclass(frozen=True)
class Function:
    """A function on a surface by its spec: a side of a channel, or the mask."""

    surface: Surface
    spec: str


@dataclass(frozen=True)
class View:
    """Everything that decides how the document is drawn, and nothing of what is solved."""

    theme: Theme = "light"
    ui_scale: float = 1.0
    layout: Layout = "automatic"
    colormap: str = "automatic"  # by the functions' signs; or one of `appearance.colormaps.NAMES`
    isolines: bool = False
    isoline_count: int = 12
    color_bar: bool = True
    look: Look | None = None  # from the surface's front, fitted
    large: str = ""  # the slot that has the others' room, too
    hidden: tuple[str, ...] = ()  # surfaces
    wireframe: bool = False
    flat: bool = False  # each face in one shade
    # a match that was found on a finer mesh shows its functions there, without streaks
    finer: bool = False
    coloring: Coloring = "function"  # of the advected surface
    blend: bool = False  # whether there is a surface for it, as for the next two
    transport: bool = False
    error: bool = False
    links: bool = False  # lines from points of surface A to where they are on B
    arrows: bool = False
    arrow_length: float = 0.12  # what the longest may have, of sqrt(area)
    arrow_density: float = 0.5  # from few to many, 0 to 1
    # of the field that is drawn, coloured and traced, or a field that belongs to it
    part: FieldPart = "whole"
    tracks: bool = False  # ways of a film's critical points
    streaks: bool = False  # on the advected surface
    fade: bool = False  # streaks, where the field is slow
    animate: bool = False  # streaks move along the field
    flow_after_match: bool = True  # whether a match that ended shows its flow and plays it
    tool: ClickTool = "nothing"
    previous_runs: bool = True  # are in the plot of what is left
    # whether what steps leave is plotted against what they cost, while a run goes on and after it
    trade_off_live: bool = False
    trade_off: bool = True
    speeds: bool = False  # of a film's intervals are plotted, and not what is left

    @property
    def preferences(self) -> View:
        """Return a view that has the user's preferences and nothing of what is shown."""
        return View(**{name: getattr(self, name) for name in _PREFERENCES})

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
class Run:
    """The energy of one run; vertices of each row's mesh, reaches, and residuals (n,) are empty if
    unknown.
    """

    energies: FloatArray  # (n, 3): total, regularity and mismatch
    stages: IntArray  # (n,)
    # rows at which a changed problem started the solver again from the field that it had
    restarts: tuple[int, ...]
    residual: float  # the least of its fields; 0 while it runs
    label: str  # what was solved, in a few words
    vertices: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    reaches: FloatArray = field(default_factory=lambda: np.zeros(0))
    words: tuple[str, ...] = ()  # of the data terms, where there are T > 1
    shares: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # (n, T), of the mismatch
    residuals: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def has_course(self) -> bool:
        return len(self.vertices) > 0

    @property
    def curves(self) -> dict[str, FloatArray]:
        """The total and all terms, (n,), by the words of the window."""
        total, regularity, mismatch = self.energies.T
        terms = dict(zip(self.words, self.shares.T, strict=True)) or {"closeness": mismatch}
        return {"energy": total, "smoothness": regularity} | terms

    @property
    def left(self) -> FloatArray:
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
    def least_left(self) -> FloatArray:
        """The least that was left so far (n,), which rises only where the problem changed; never
        less than what a field leaves that the run gave: on coarser meshes it may be less.
        """
        parts = np.split(self.left, [row for row in self.restarts if row < len(self.stages)])
        least = [np.fmin.accumulate(part) for part in parts]
        return np.concatenate([*least[:-1], np.maximum(least[-1], self.residual)])


class Identity:
    """What stays the same of a document while it is edited; equal only to itself."""


@dataclass(frozen=True, eq=False)
class Document:
    """A state of the session that undo returns to and a project file keeps."""

    surfaces: tuple[Surface, ...]  # the only one, or A and B
    channels: tuple[Channel, ...] = ()  # until the default functions of a new mesh are known
    channel: int = 0  # the active one
    side: Side = "source"  # of it, the active one
    bump: int = 0  # which of that side's Gaussians the mouse moves
    parameters: Parameters = field(default_factory=Parameters)
    mask: str = ""  # spec of the weight of the mismatch at each vertex; empty for none
    landmarks: tuple[Landmark, ...] = ()
    landmark: int = 0  # the active one
    landmarks_alone: bool = False  # whether functions do not count, as long as there are landmarks
    initial: str = ""  # word of the map from A to B; empty for one that is chosen by what there is
    labels: LabelMap | None = None  # of the source's surface
    comparison: Comparison | None = None  # of a subject with its population
    result: Match | None = None
    initial_map: InitialMap | None = None  # that the result began with
    # the step at which the result's match ended, where another one of its path is shown
    chosen: int | None = None
    runs: tuple[Run, ...] = ()  # those that ended, the latest last
    time: float = 0.0  # shown, 0 to 2 tau; of a film from its first to its last frame
    film: Film | None = None  # in place of channels
    settings: FilmSettings = field(default_factory=FilmSettings)  # of a film's match
    sequence: Sequence | None = None  # a film's result
    lines: tuple[Point, ...] = ()  # where flow lines start
    points: tuple[Point, ...] = ()  # that are followed, at time 0
    called: dict[str, str] = field(default_factory=dict)  # functions of results, by their specs
    view: View = field(default_factory=View)
    identity: Identity = field(default_factory=Identity)

    @property
    def active(self) -> Channel | None:
        return self.channels[self.channel] if self.channels else None

    @property
    def pairs(self) -> tuple[Landmark, ...]:
        """Landmarks that are placed on both sides, which are matched."""
        return tuple(landmark for landmark in self.landmarks if landmark.is_whole)

    @property
    def is_of_landmarks(self) -> bool:
        """Whether landmarks are all that is matched."""
        return self.landmarks_alone and bool(self.pairs)

    @property
    def asked(self) -> Asked:
        return Asked(self.initial, self.channels, self.mask, self.pairs, self.landmarks_alone)

    @property
    def weights(self) -> tuple[float, ...]:
        """Weight of each channel's mismatch; 0 where landmarks alone are matched."""
        return tuple(0.0 if self.is_of_landmarks else one.weight for one in self.channels)

    @property
    def name(self) -> str:
        if self.film is not None and self.film.name != self.surface().name:
            return f"{self.film.name} on {self.surface().name}"
        return " to ".join(surface.name for surface in self.surfaces)

    @property
    def is_pair(self) -> bool:
        return len(self.surfaces) > 1

    def surface(self, slot: str = "advected") -> Surface:
        """The surface that a slot shows, on which a side's functions are: of two, the source is on
        A, and all else, as the flow, on B.
        """
        return self.surfaces[0 if slot == "source" else -1]

    @property
    def compared(self) -> Comparison | None:
        """The comparison, as long as the active channel is the one that it is of."""
        active, found = self.active, self.comparison
        if found is None or active is None:
            return None
        return found if (active.source, active.target) in found.channels else None

    def titled(self, slot: str) -> str:
        """A slot's name, of two surfaces with which of them it shows: ``source on A``, of a film
        which frame or time.
        """
        if self.film is not None and slot in (*SIDES, "advected"):
            before = self.film.interval(self.time)
            named = {"source": self.film.frame(before), "target": self.film.frame(before + 1)}
            return named.get(slot) or f"at {self.film.precisely(self.time)}"
        if self.compared is not None and not (slot == "advected" and self.result):
            return self.compared.title(slot)
        return f"{slot} on {'A' if slot == 'source' else 'B'}" if self.is_pair else slot

    def facing(self, front: Front, slot: str = "advected") -> Document:
        """Return it with the surface of a slot seen from another side."""
        seen = self.surface(slot)
        surfaces = (replace(one, front=front) if one is seen else one for one in self.surfaces)
        return replace(self, surfaces=tuple(surfaces))

    def known_as(self, side: Side, spec: str) -> str:
        """Return the name of a function's values from files: of two surfaces, A's have a prefix."""
        return f"{OF_A if self.is_pair and side == 'source' else ''}{spec}"

    def known_on(self, side: Side, known: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return those values, by their names, that are of a side's surface, by specs."""
        if not self.is_pair:
            return dict(known)
        own = {name: name.startswith(OF_A) == (side == "source") for name in known}
        return {name.removeprefix(OF_A): known[name] for name, is_own in own.items() if is_own}

    def function(self, side: Side, channel: Channel | None = None) -> Function:
        channel = channel or self.channels[self.channel]
        return Function(self.surface(side), channel.spec(side))

    @property
    def mask_function(self) -> Function:
        return Function(self.surface("target"), self.mask)

    @property
    def has_missing(self) -> bool:
        """Whether the mask tells where functions have no values."""
        return self.mask.endswith(f",column={MEASURED}") and not self.is_pair

    @property
    def functions(self) -> tuple[Function, ...]:
        found = [self.function(side, channel) for channel in self.channels for side in SIDES]
        return tuple(dict.fromkeys([*found, self.mask_function] if self.mask else found))

    @property
    def start(self) -> float:
        return 0.0 if self.film is None else float(self.film.times[0])

    @property
    def end(self) -> float:
        if self.film is not None:
            return float(self.film.times[-1])
        return EXTRAPOLATION * self.parameters.tau

    @property
    def last(self) -> float:
        """The time at which the target is reached, or of a film its last frame."""
        return self.parameters.tau if self.film is None else self.end

    @property
    def times_told(self) -> str:
        """Say which times can be shown."""
        told = f"{self.start:g} to {self.end:g}"
        return told if self.film else f"{told}, which is {EXTRAPOLATION:g} tau"

    @property
    def is_film_outdated(self) -> bool:
        """Whether a film's result is of other frames or settings."""
        film, found = self.film, self.sequence
        return film is not None and found is not None and not is_of(found, film, self.settings)

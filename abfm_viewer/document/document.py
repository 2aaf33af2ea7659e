"""What a project holds: immutable, so that undo, saving and pictures all work on whole states."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray, IntArray

Side = Literal["source", "target"]
Theme = Literal["light", "dark"]
Layout = Literal["row", "column", "advected only"]
Coloring = Literal[
    "function",
    "speed",
    "divergence",
    "curl",
    "coordinates",
    "checker",
    "area distortion",
    "conformal distortion",
]
FieldPart = Literal["whole", "curl-free", "divergence-free", "harmonic", "commuting", "carried gradient"]
ClickTool = Literal["nothing", "flow line", "follow a point"]

COLORINGS: tuple[Coloring, ...] = get_args(Coloring)
SIDES: tuple[Side, ...] = ("source", "target")
THEMES: tuple[Theme, ...] = ("light", "dark")
LAYOUTS: tuple[Layout, ...] = ("row", "column", "advected only")
HODGE_PARTS: tuple[FieldPart, ...] = ("curl-free", "divergence-free", "harmonic")
FIELD_PARTS: tuple[FieldPart, ...] = ("whole", *HODGE_PARTS, "commuting", "carried gradient")
CLICK_TOOLS: tuple[ClickTool, ...] = ("nothing", "flow line", "follow a point")
Triple = tuple[float, float, float]
EXTRAPOLATION = 2.0
"""The time bar goes to this many times tau."""


def triple(values: FloatArray) -> Triple:
    """A vector (3,) as documents hold it: immutable."""
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class Channel:
    """A source and a target as specs of `abfm.functions`, and the weight of their mismatch."""

    source: str
    target: str
    weight: float = 1.0

    def spec(self, side: Side) -> str:
        """The spec of one side."""
        return self.source if side == "source" else self.target


@dataclass(frozen=True)
class Point:
    """A point of the surface: a face (of the mesh, not the file) and its barycentric weights."""

    face: int
    barycentric: Triple


@dataclass(frozen=True)
class Camera:
    """Where a window or picture looks from: position, target and up (3,) each, and the vertical angle in degrees.

    The aspect, width over height, is that of the part of the window with the surfaces; 0 where it does not matter.
    """

    position: Triple
    target: Triple
    up: Triple
    angle: float
    aspect: float = 0.0

    @property
    def front(self) -> Front:
        """The direction in which it looks, without the distance."""
        backward = np.array(self.position) - self.target
        return Front(triple(backward / np.linalg.norm(backward)), self.up)


@dataclass(frozen=True)
class Front:
    """The side of the mesh that faces the viewer, from which surfaces stand side by side: two unit vectors (3,)."""

    direction: Triple
    up: Triple

    @property
    def axes(self) -> FloatArray:
        """What is to the right, up, and towards the viewer, as rows (3, 3)."""
        return np.stack([np.cross(self.up, self.direction), self.up, self.direction])


@dataclass(frozen=True)
class View:
    """Everything that decides how the document is drawn, and nothing that decides what is solved.

    Attributes
    ----------
    colormap : str
        "automatic" (sequential or diverging by the functions' signs), or one of `appearance.colormaps.NAMES`.
    front : Front or None
        None until the default functions are known, which it should show.
    camera : Camera or None
        None is the fitted front view.
    coloring : Coloring
        What the advected surface shows.
    blend, transport, error : bool
        Whether the surfaces of the linear blend, of optimal transport and of the pointwise error are there.
    arrows, arrow_length, arrow_density
        Whether the field is drawn, the longest arrow as a fraction of sqrt(area), and the share of faces with one.
    part : FieldPart
        Which Helmholtz-Hodge part of the field is drawn, coloured and traced; or the smoothest field that commutes with
        it, or the source's gradient carried along.
    streaks : bool
        Line integral convolution of the field on the advected surface.
    fade, animate : bool
        Whether the streaks fade where the field is slow, and whether they move along it.
    tool : ClickTool
        What a click on a surface does.
    previous_runs : bool
        Whether the plot of the energy shows earlier runs.
    """

    theme: Theme = "light"
    ui_scale: float = 1.0
    layout: Layout = "row"
    colormap: str = "automatic"
    isolines: bool = False
    isoline_count: int = 12
    color_bar: bool = True
    front: Front | None = None
    camera: Camera | None = None
    coloring: Coloring = "function"
    blend: bool = False
    transport: bool = False
    error: bool = False
    arrows: bool = False
    arrow_length: float = 0.12
    arrow_density: float = 0.3
    part: FieldPart = "whole"
    streaks: bool = False
    fade: bool = False
    animate: bool = False
    tool: ClickTool = "nothing"
    previous_runs: bool = True


@dataclass(frozen=True, eq=False)
class Run:
    """The energy of one run: what the plot of the energy shows of it.

    Attributes
    ----------
    energies : (n, 3) array
        Total, regularity and mismatch.
    stages : (n,) array of int
        Stage of each row.
    restarts : tuple of int
        Rows at which a change of the problem started the solver again from the field that it had.
    mismatch : float
    label : str
        What was solved, in a few words.
    vertices : (n,) or (0,) array of int
        Of the mesh of each row, which may be a coarser one than the document's; empty where this is not known.
    reaches : (n,) or (0,) array
        The reach of each row's stage, likewise.
    """

    energies: FloatArray
    stages: IntArray
    restarts: tuple[int, ...]
    mismatch: float
    label: str
    vertices: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    reaches: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def has_course(self) -> bool:
        """Whether meshes and reaches are known."""
        return len(self.vertices) > 0


@dataclass(frozen=True, eq=False)
class Document:
    """A state of the session that undo returns to and a project file keeps.

    Attributes
    ----------
    mesh : TriangleMesh
    name : str
        What the mesh is called in the window.
    channels : tuple of Channel
        Empty until the default functions of a new mesh are known.
    channel, side, bump : int, Side, int
        The active channel, its active side, and which of that side's Gaussians the mouse moves.
    parameters : Parameters
    mask : str
        Spec of the weight of the mismatch at each vertex; empty for none.
    result : Match or None
    runs : tuple of Run
        Those that ended, the latest last.
    time : float
        The time shown, 0 to 2 tau.
    lines, points : tuple of Point
        Where flow lines and followed points start.
    view : View
    """

    mesh: TriangleMesh
    name: str
    channels: tuple[Channel, ...] = ()
    channel: int = 0
    side: Side = "source"
    bump: int = 0
    parameters: Parameters = field(default_factory=Parameters)
    mask: str = ""
    result: abfm.Match | None = None
    runs: tuple[Run, ...] = ()
    time: float = 0.0
    lines: tuple[Point, ...] = ()
    points: tuple[Point, ...] = ()
    view: View = field(default_factory=View)

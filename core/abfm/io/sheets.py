"""Figures as data: the pictures and plots of a figure before they are drawn."""

from dataclasses import dataclass
from typing import Literal

from abfm.display import BEST_VIEW, ViewSpec
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

Frame = Literal["source", "target", "result", "field", "other"]
"""Frame of a panel: blue, red, black and grey as in the paper; others have a thin light frame."""
Up = Literal["x", "y", "z"]


@dataclass(frozen=True, eq=False)
class Values:
    """A function (V,) or (F,) as colours; functions with equal titles ``bar`` share a range."""

    values: FloatArray
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Positions (V, 3) as colours: x, y, z in the bounding box of the mesh as red, green, blue."""

    positions: FloatArray


@dataclass(frozen=True, eq=False)
class Checker:
    """A checkerboard by texture coordinates (V, 2), with two squares per unit."""

    coordinates: FloatArray


@dataclass(frozen=True, eq=False)
class Streaks:
    """Line integral convolution of a field (F, 3), optionally coloured by a function (V,)."""

    velocity: FloatArray
    values: FloatArray | None = None
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture of a surface; pictures of the same mesh in a figure share a camera."""

    mesh: TriangleMesh
    paint: Values | Coordinates | Checker | Streaks
    label: str
    frame: Frame = "other"
    points: FloatArray | None = None  # (P, 3), points; point i has the same colour in all panels
    lines: tuple[FloatArray, ...] = ()  # lines on the surface, (K, 3)
    arrows: FloatArray | None = None  # a field, (F, 3)
    determined: FloatArray | None = None  # (F,) certainty from 0 to 1, the opacity of arrows
    # colour of the label, independent of the frame
    tone: Literal["", "good", "warning", "failure", "muted"] = ""


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a plot with its name for the legend; reference curves are `faint`."""

    name: str
    x: FloatArray
    y: FloatArray
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """A plot of curves; its width is counted in panels, and curves are cut off above ``top``."""

    curves: tuple[Curve, ...]
    x_title: str
    y_title: str
    label: str
    log_y: bool = False
    width: int = 2
    top: float | None = None


@dataclass(frozen=True, eq=False)
class Sheet:
    rows: tuple[tuple[Panel | Plot, ...], ...]
    view: ViewSpec = BEST_VIEW
    # functions (V,) on the first mesh that the camera must show; by default those of the source and
    # target panels
    view_functions: tuple[FloatArray, ...] = ()
    one_view: bool = False  # whether all meshes have the camera of the first (poses of one body)
    notes: tuple[str, ...] = ()  # lines of text below the pictures

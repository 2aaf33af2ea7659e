"""A figure as data: which pictures and plots it consists of, for whoever can draw."""

from dataclasses import dataclass
from typing import Literal

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

Frame = Literal["source", "target", "result", "field", "other"]
"""Blue, red, black and grey in the paper's figures; the others have a thin light frame."""
Up = Literal["x", "y", "z"]


@dataclass(frozen=True, eq=False)
class Values:
    """A function (V,) or (F,), and the title of its colour bar; what has the same title shares one range."""

    values: FloatArray
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Places (V, 3) in the mesh's units as colours: x, y, z of its bounding box as red, green, blue."""

    positions: FloatArray


@dataclass(frozen=True, eq=False)
class Checker:
    """A checkerboard by texture coordinates (V, 2); one unit is the side of two fields."""

    coordinates: FloatArray


@dataclass(frozen=True, eq=False)
class Streaks:
    """Line integral convolution of a field (F, 3), in the colours of a function (V,) if given; `bar` as in `Values`."""

    velocity: FloatArray
    values: FloatArray | None = None
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture of a surface, with a short label below; all panels of a sheet with the same mesh have one camera.

    On the surface: marked points (P, 3) in the mesh's units, each in a colour of its own, the same in all panels;
    lines, paths (K, 3); and arrows, a field (F, 3).
    """

    mesh: TriangleMesh
    paint: Values | Coordinates | Checker | Streaks
    label: str
    frame: Frame = "other"
    points: FloatArray | None = None
    lines: tuple[FloatArray, ...] = ()
    arrows: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a plot: a name for the legend, and places x, y (K,) each; `faint` for what it is compared with."""

    name: str
    x: FloatArray
    y: FloatArray
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over axes, of which the titles have units, as wide as `width` panels, with a short label below.

    `top` is the greatest value of y that is shown: a curve that goes beyond leaves the plot.
    """

    curves: tuple[Curve, ...]
    x_title: str
    y_title: str
    label: str
    log_y: bool = False
    width: int = 2
    top: float | None = None


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows of panels and plots, and notes: what must be said with the pictures, a line each below them.

    `up` is the axis that points upwards; `seen` are functions (V,) on the first panel's mesh whose remarkable parts the
    camera must show, by default those of the source and target panels; with `one_view` all meshes are seen from the
    direction of the first: poses of one body.
    """

    rows: tuple[tuple[Panel | Plot, ...], ...]
    up: Up = "y"
    seen: tuple[FloatArray, ...] = ()
    one_view: bool = False
    notes: tuple[str, ...] = ()

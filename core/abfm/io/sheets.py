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
    """A function (V,) or (F,); what has the same title of its colour bar shares one range."""

    values: FloatArray
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Places (V, 3) as colours: x, y, z of the mesh's bounding box as red, green, blue."""

    positions: FloatArray


@dataclass(frozen=True, eq=False)
class Checker:
    """A checkerboard by texture coordinates (V, 2), of which one unit is the side of two fields."""

    coordinates: FloatArray


@dataclass(frozen=True, eq=False)
class Streaks:
    """Line integral convolution of a field (F, 3), in the colours of a function (V,) if given."""

    velocity: FloatArray
    values: FloatArray | None = None
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture of a surface; all of a sheet with the same mesh have one camera."""

    mesh: TriangleMesh
    paint: Values | Coordinates | Checker | Streaks
    label: str
    frame: Frame = "other"
    points: FloatArray | None = None  # (P, 3), each marked in a colour, the same in all panels
    lines: tuple[FloatArray, ...] = ()  # paths on the surface, (K, 3)
    arrows: FloatArray | None = None  # a field, (F, 3)
    determined: FloatArray | None = None  # how well, (F,), from 0 to 1: opacities of arrows
    tone: Literal["", "good", "warning", "failure", "muted"] = (
        ""  # of the label, in another colour than the frame's
    )


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a plot, its name for the legend; `faint` is what others are compared with."""

    name: str
    x: FloatArray
    y: FloatArray
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over axes, so many panels wide; one that goes beyond the `top` leaves the plot."""

    curves: tuple[Curve, ...]
    x_title: str
    y_title: str
    label: str
    log_y: bool = False
    width: int = 2
    top: float | None = None


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows of panels and plots."""

    rows: tuple[tuple[Panel | Plot, ...], ...]
    up: Up | None = None
    # functions (V,) on the first mesh for the camera to show; by default source and target panels'
    seen: tuple[FloatArray, ...] = ()
    one_view: bool = False  # all meshes from the direction of the first: poses of one body
    notes: tuple[str, ...] = ()  # lines below the pictures, which must be said with them

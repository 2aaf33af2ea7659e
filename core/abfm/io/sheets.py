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
    """Places (V, 3), in the mesh's units, as colours: x, y, z of its bounding box as red, green,
    blue.
    """

    positions: FloatArray


@dataclass(frozen=True, eq=False)
class Checker:
    """A checkerboard by texture coordinates (V, 2), of which one unit is the side of two fields."""

    coordinates: FloatArray


@dataclass(frozen=True, eq=False)
class Streaks:
    """Line integral convolution of a field (F, 3), in the colours of a function (V,) if given;
    `bar` as in `Values`.
    """

    velocity: FloatArray
    values: FloatArray | None = None
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture of a surface; all of a sheet with the same mesh have one camera.

    Attributes
    ----------
    label : str
        Below the picture, short.
    points : (P, 3) array or None
        Marked places, in the mesh's units, each in a colour of its own, the same in all panels.
    lines : tuple of (K, 3) arrays
        Paths on the surface.
    arrows : (F, 3) array or None
        A field as arrows on the surface.
    tone : "", "good" or "failure"
        What the label says of a result, which gives it another colour than the frame's.
    """

    mesh: TriangleMesh
    paint: Values | Coordinates | Checker | Streaks
    label: str
    frame: Frame = "other"
    points: FloatArray | None = None
    lines: tuple[FloatArray, ...] = ()
    arrows: FloatArray | None = None
    tone: Literal["", "good", "failure"] = ""


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a plot: a name for the legend, and places x, y (K,) each; `faint` for what it
    is compared with.
    """

    name: str
    x: FloatArray
    y: FloatArray
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over axes, whose titles have the units, so many panels wide; a curve that goes beyond
    the `top` leaves the plot.
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
    """Rows of panels and plots.

    Attributes
    ----------
    seen : tuple of (V,) arrays
        Functions on the first panel's mesh whose remarkable parts the camera must show; by default
        those of the source and target panels.
    one_view : bool
        Whether all meshes are seen from the direction of the first: poses of one body.
    notes : tuple of str
        What must be said with the pictures, a line each: they stand below them.
    """

    rows: tuple[tuple[Panel | Plot, ...], ...]
    up: Up = "y"
    seen: tuple[FloatArray, ...] = ()
    one_view: bool = False
    notes: tuple[str, ...] = ()

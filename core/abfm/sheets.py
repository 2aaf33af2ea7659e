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
    """A function.

    Attributes
    ----------
    values : (V,) or (F,) array
    bar : str
        Title of the colour bar; what has the same title shares one range.
    """

    values: FloatArray
    bar: str = "function"


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Places as colours: x, y, z of the mesh's bounding box as red, green, blue.

    Attributes
    ----------
    positions : (V, 3) array
        In the mesh's units.
    """

    positions: FloatArray


@dataclass(frozen=True, eq=False)
class Checker:
    """A checkerboard by texture coordinates.

    Attributes
    ----------
    coordinates : (V, 2) array
        One unit is the side of two fields.
    """

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
    """A picture of a surface.

    Attributes
    ----------
    mesh : TriangleMesh
        All panels of a sheet with the same mesh have one camera.
    paint : Paint
    label : str
        Below the picture, short.
    tone : "", "good" or "failure"
        What the label says of a result, which gives it another colour than the frame's.
    frame : Frame
    points : (P, 3) array or None
        Marked places, in the mesh's units, each in a colour of its own, the same in all panels.
    lines : tuple of (K, 3) arrays
        Paths on the surface.
    arrows : (F, 3) array or None
        A field as arrows on the surface.
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
    """Curves over axes.

    Attributes
    ----------
    curves : tuple of Curve
    x_title, y_title : str
        With units.
    label : str
        Below the plot, short.
    log_y : bool
        Whether the vertical axis is logarithmic.
    width : int
        How many panels wide.
    top : float or None
        Greatest value of y that is shown: a curve that goes beyond leaves the plot.
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
    rows : tuple of tuples
    up : Up
        The axis that points upwards.
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

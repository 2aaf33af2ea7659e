"""What each surface shows: values and their range, decided from the session without drawing anything."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from abfm.mesh import FloatArray
from abfm_viewer.colormaps import ColorRange, color_range
from abfm_viewer.session import Session

Kind = Literal["vertex values", "face values", "colors", "checker"]


@dataclass(frozen=True, eq=False)
class Paint:
    """One surface's colours.

    Attributes
    ----------
    kind : Kind
    values : array
        (V,), (F,), (V, 3) RGB from 0 to 1, or (V, 2) texture coordinates.
    title : str
        What the colours mean, for the label above the surface.
    colors : ColorRange or None
        None where the values are colours themselves.
    bar : str
        Title of the colour bar; surfaces with the same title share one.
    """

    kind: Kind
    values: FloatArray
    title: str
    colors: ColorRange | None = None
    bar: str = ""


def surfaces(session: Session) -> tuple[str, ...]:
    """Names of the surfaces that the view shows, in their order."""
    view = session.view
    extra = [*(["linear blend"] if view.blend else []), *(["error"] if view.error else [])]
    if view.layout == "advected only":
        return ("advected", *extra)
    return ("source", "advected", *extra, "target")


class Painter:
    """Decides the paint of every surface; keeps what was decided while nothing that matters changes."""

    def __init__(self) -> None:
        self._range: tuple[object, object, str, ColorRange] | None = None

    def paint(self, session: Session, name: str) -> Paint | None:
        """What a surface shows now; None while nothing is known."""
        source, target = session.values("source"), session.values("target")
        if source is None or target is None:
            return None
        colors = self._function_range(session, source, target)
        if name in ("source", "target"):
            return Paint("vertex values", source if name == "source" else target, name, colors, "function")
        advected = session.advected()
        if advected is None:
            return None
        if name == "linear blend":
            from abfm.baselines import linear_blend

            share = min(session.time / session.parameters.tau, 1.0)
            return Paint("vertex values", linear_blend(source, target, share), "linear blend", colors, "function")
        if name == "error":
            error = np.abs(target - advected)
            top = max(float(error.max()), 1e-12)
            return Paint(
                "vertex values", error, f"error, at most {top:.3g}", _ranged(session, 0.0, top), "|target - advected|"
            )
        return Paint("vertex values", advected, "advected", colors, "function")

    def _function_range(self, session: Session, source: FloatArray, target: FloatArray) -> ColorRange:
        known, wanted = self._range, session.view.colormap
        if known is None or known[0] is not source or known[1] is not target or known[2] != wanted:
            colors = color_range(source, target)
            if wanted != "automatic":
                colors = replace(colors, colormap=wanted)
            known = self._range = (source, target, wanted, colors)
        return known[3]


def _ranged(session: Session, low: float, high: float) -> ColorRange:
    automatic = session.view.colormap == "automatic"
    return ColorRange("abfm sequential" if automatic else session.view.colormap, low, high)
